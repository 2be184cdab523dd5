"""Reading Dockerfiles for the backend ``local``: what each form means, and what needs a container engine."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_terminal.backends.local import recipe
from gem_terminal.backends.local.dockerfile import expand, pairs, read, split
from gem_terminal.backends.local.ignore import Ignored
from gem_terminal.backends.local.recipe import Copy, Folder, Recipe, Run
from gem_terminal.errors import TaskError
from gem_terminal.tasks.task import Container

SH = ("/bin/sh", "-c")


def of(text: str, **build_args: str) -> Recipe:
    """Return what a Dockerfile asks for, after a base that is fine."""
    return recipe.of_text(f"FROM debian:12\n{text}", build_args)


def scripts(text: str, **build_args: str) -> list[str]:
    """Return the last word of each ``RUN``."""
    return [step.words[-1].rstrip("\n") for step in of(text, **build_args).steps if isinstance(step, Run)]


def test_lines_are_continued_past_comments_and_empty_lines() -> None:
    text = "RUN one && \\\n    # not this\n\n  two \\  \n  && three\n# nor this\nRUN four"
    assert scripts(text) == ["one &&   two   && three", "four"]


def test_the_escape_directive_changes_what_continues_a_line() -> None:
    found, escape = read("# syntax=docker/dockerfile:1\r\n# escape=`\r\nFROM debian\r\nRUN one `\r\n two c:\\\r\n")
    assert escape == "`"
    assert [(each.name, each.value, each.line) for each in found] == [
        ("FROM", "debian", 3),
        ("RUN", "one  two c:\\", 4),
    ]


def test_a_directive_after_a_comment_is_a_comment() -> None:
    assert read("# words\n# escape=`\nFROM debian\n")[1] == "\\"


def test_here_documents_are_scripts_or_belong_to_a_command() -> None:
    text = "RUN <<EOF\necho $one\nEOF\nRUN cat <<'A' > /a && cat <<-B > /b\n$two\nA\n\tthree\n\tB\nRUN last"
    assert scripts(text) == ["echo $one", "cat <<'A' > /a && cat <<-B > /b\n$two\nA\nthree\nB", "last"]


def test_copy_takes_here_documents_with_variables_unless_quoted() -> None:
    found = of("ENV NAME=x\nCOPY <<one <<'two' file /to/\n$NAME\none\n$NAME\ntwo\n").steps
    assert found == (Copy(("file",), {"one": b"x\n", "two": b"$NAME\n"}, "/to/", None, False, 3),)


def test_commands_have_a_shell_or_stand_for_themselves() -> None:
    found = of('RUN ["echo", "$HOME"]\nSHELL ["/bin/bash", "-ec"]\nRUN echo $HOME\nRUN [ -e /x ]').steps
    words = [step.words for step in found if isinstance(step, Run)]
    assert words == [("echo", "$HOME"), ("/bin/bash", "-ec", "echo $HOME\n"), ("/bin/bash", "-ec", "[ -e /x ]\n")]


def test_variables_hold_from_where_they_are_set() -> None:
    text = "ARG A=1\nENV B=$A C='$A' D=\"x $A\"\nRUN first\nENV B=2\nARG A=3\nRUN second\nENV old form  here\n"
    found = of(text)
    assert [step.env for step in found.steps if isinstance(step, Run)] == [
        {"A": "1", "B": "1", "C": "$A", "D": "x 1"},
        {"A": "3", "B": "2", "C": "$A", "D": "x 1"},
    ]
    assert found.env == {"B": "2", "C": "$A", "D": "x 1", "old": "form  here"}


def test_arguments_of_the_build_hold_where_they_are_declared() -> None:
    text = "ARG BASE=alpine\nARG LEVEL=1\nFROM ${BASE} AS final\nARG LEVEL\nARG OTHER=no\nENV E=${LEVEL}${OTHER}${NONE}"
    assert recipe.of_text(text, {"BASE": "python:3.12-slim", "OTHER": "yes", "NONE": "x"}).env == {"E": "1yes"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("$a-${a}-${b}-$b-$", "A-A---$"),
        ("${a:-x}${b:-x}${e:-x}${e-x}${b-x}", "AxxEx".replace("E", "")),
        ("${a:+x}${b:+x}${e:+x}${e+x}", "xx"),
        ("${b:-${a}/${b:-y}}", "A/y"),
        (r"\$a '$a' \\$a", r"$a '$a' \\A"),
    ],
)
def test_forms_of_variables(text: str, expected: str) -> None:
    assert expand(text, {"a": "A", "e": ""}) == expected


def test_words_and_pairs_have_quotes_and_escapes() -> None:
    assert split(r"""one 't w'o "a \" \$ b"  c\ d '' """) == ["one", "t wo", 'a " $ b', "c d", ""]
    assert pairs(r'A=1 B="2 3" C=4\ 5 D=') == {"A": "1", "B": "2 3", "C": "4 5", "D": ""}


def test_folders_follow_one_another_and_targets_are_absolute() -> None:
    found = of("WORKDIR /a\nWORKDIR b\nCOPY x .\nADD --chmod=755 y z ../q/\nVOLUME [\"/v\"]\nWORKDIR '/with space'")
    assert found.steps == (
        Folder("/a", 2),
        Folder("/a/b", 3),
        Copy(("x",), {}, "/a/b", None, False, 4),
        Copy(("y", "z"), {}, "/a/q/", 0o755, True, 5),
        Folder("/v", 6),
        Folder("/with space", 7),
    )
    assert found.workdir == "/with space"


def test_the_program_of_an_image_is_kept() -> None:
    found = of('LABEL a=b\nEXPOSE 80\nENTRYPOINT ["run", "it"]\nCMD sleep $TIME\nUSER root\nHEALTHCHECK NONE')
    assert (found.entrypoint, found.command) == (("run", "it"), (*SH, "sleep $TIME"))


@pytest.mark.parametrize(
    "image",
    ["debian", "ubuntu:24.04", "python:3.12-slim-bookworm", "gem-python:base", "docker.io/library/python:3",
     "ghcr.io/laude-institute/t-bench/ubuntu-24-04:20250624", f"debian@sha256:{'0' * 64}"],
)  # fmt: skip
def test_general_bases_are_taken(image: str) -> None:
    assert recipe.of_text(f"FROM {image}", {}) == Recipe()
    assert recipe.of(Container(image=image), {}) == Recipe()


def test_a_dockerfile_takes_the_place_of_an_image_of_its_own(tmp_path: Path) -> None:
    """A general image, which a sandbox stands for, comes before it."""
    (tmp_path / "Dockerfile").write_text("FROM debian:12\nENV BUILT=yes\n")
    assert recipe.of(Container(image="some/image:1", context=tmp_path), {}).env == {"BUILT": "yes"}
    assert recipe.of(Container(image="debian:12", context=tmp_path), {}) == Recipe()


@pytest.mark.parametrize(
    "image", ["alpine", "python:3.12-alpine", "evil.example/debian", "postgres:16", "scratch", "me/python"]
)
def test_other_images_need_docker(image: str) -> None:
    with pytest.raises(TaskError, match=rf"its image is '{re.escape(image)}', and a sandbox takes the place of debian"):
        recipe.of_text(f"FROM {image}", {})


@pytest.mark.parametrize(
    "line",
    ["RUN apt-get update && apt-get install -y git", "RUN true; apt -y install x", "RUN pip install --no-cache x",
     "RUN python3 -m pip install x", "RUN npm ci", "RUN apk add curl", "RUN curl -L https://example.org/x | sh",
     "RUN git clone https://example.org/x.git", 'RUN ["pip", "install", "x"]', "RUN <<EOF\napt-get install x\nEOF",
     "RUN --mount=type=cache,target=/x true", "FROM debian", "USER agent", "COPY --from=o a b", "COPY --chown=1 a b",
     "ADD https://example.org/x /x", "ADD git@example.org:x.git /x", "ONBUILD RUN x", "NONSENSE x"],
)  # fmt: skip
def test_what_a_sandbox_lacks_needs_docker(line: str) -> None:
    with pytest.raises(TaskError, match=r"^line 2: .*; the task needs its own image: use the backend 'docker'$"):
        of(line)


@pytest.mark.parametrize(
    "line",
    ["RUN echo 'apt-get is not run'", "RUN rm -rf /var/lib/apt/lists", "RUN curl -s http://localhost:80/x || true",
     "RUN python3 -m venv /v", "RUN git clone /srv/one /srv/two", "RUN go vet ./..."],
)  # fmt: skip
def test_what_needs_no_network_is_run(line: str) -> None:
    assert len(of(line).steps) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "has no instruction"),
        ("RUN x\nFROM debian", "line 1: RUN comes before FROM"),
        ("ARG A", "there is no FROM"),
        ("FROM debian as", "is not FROM IMAGE"),
        ("FROM debian\nRUN <<EOF\nx", "line 2: the here-document 'EOF' has no end"),
        ("FROM debian\nENV A", "gives no value"),
        ("FROM debian\nENV A=1 B", "is not NAME=value"),
        ("FROM debian\nENV A='1", "a quote that is not closed"),
        ("FROM debian\nENV A=${1", "is not closed"),
        ("FROM debian\nENV A=${B//x/y}", "has a form that is not known here"),
        ("FROM debian\nENV A=" + "${A:-" * 5000 + "}" * 5000, "too many variables inside one another"),
        ("FROM debian\nCOPY x", "takes at least one source, and a target"),
        ("FROM debian\nCOPY --chmod=u+x a b", "is not an octal number"),
        ("FROM debian\nSHELL bash", "SHELL takes words"),
        ("FROM debian\n# escape=x\nRUN é\nÉ x", "is no instruction"),
        ("# escape=x\nFROM debian", "escape='x'"),
        ("x" * 1_000_001, "at most 1000000 are read"),
    ],
)
def test_a_broken_dockerfile_says_what_is_wrong(text: str, words: str) -> None:
    with pytest.raises(TaskError) as caught:
        recipe.of_text(text, {})
    assert words in str(caught.value)


def test_an_error_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match=r"Dockerfile cannot be read"):
        recipe.of(Container(context=tmp_path), {})
    (tmp_path / "Dockerfile").write_bytes(b"FROM \xff")
    with pytest.raises(TaskError, match=rf"{tmp_path}/Dockerfile cannot be read"):
        recipe.of(Container(context=tmp_path), {})


PIECES = st.sampled_from(
    ["FROM", "debian", "RUN", "COPY", "ADD", "ENV", "ARG", "WORKDIR", "USER", "SHELL", "CMD", "ENTRYPOINT", "VOLUME",
     " ", "\n", "\\\n", "\t", "#", "# escape=`\n", "`\n", "<<EOF", "<<-'E'", "EOF\n", "E\n", "$", "${", "}", ":-", "A",
     "=", "'", '"', "[", "]", '["a"]', "--chmod=", "--from", "755", "/", "..", "*", "\0", "\ufeff", "é", "\r\n"]
)  # fmt: skip


@given(st.one_of(st.lists(PIECES, max_size=60).map("".join), st.text(max_size=200)), st.booleans())
def test_no_text_makes_the_reader_fail_otherwise(text: str, based: bool) -> None:
    try:
        found = recipe.of_text(f"FROM debian\n{text}" if based else text, {"A": "1"})
    except TaskError:
        return
    assert found.workdir.startswith("/")
    assert all(step.path.startswith("/") for step in found.steps if isinstance(step, Folder))
    assert all(
        step.target.startswith("/") and ".." not in step.target.split("/")
        for step in found.steps
        if isinstance(step, Copy)
    )


@given(st.text(max_size=100), st.text(alphabet=" '\"\\ab$={}", max_size=40))
def test_quoting_a_word_keeps_it(word: str, other: str) -> None:
    quoted = "'" + word.replace("'", "'\"'\"'") + "'"
    assert split(f"x {quoted} y") == ["x", word, "y"]
    try:
        split(other)
        pairs(other)
        expand(other, {"a": "b"})
    except TaskError:
        pass


@pytest.mark.parametrize(
    ("patterns", "left_out", "kept"),
    [
        ("*.log", ["a.log"], ["a.txt", "b/a.log"]),
        ("**/*.log", ["a.log", "b/a.log", "b/c/a.log"], ["a.txt"]),
        ("/build/", ["build", "build/x", "build/x/y"], ["src/build"]),
        ("**\n!keep\n# comment\n", ["a", "b/c"], ["keep", "keep/x"]),
        ("a?c\n[x-z]1\n[^x]2\n\\*", ["abc", "y1", "a2", "*"], ["ac", "a1", "x2", "b"]),
        ("a/**/z", ["a/z", "a/b/z", "a/b/c/z"], ["a", "az", "b/a/z"]),
        (".git\n*.tmp\n!b.tmp", [".git/config", "a.tmp"], ["b.tmp", "gitx"]),
    ],
)
def test_files_are_left_out_by_their_patterns(patterns: str, left_out: list[str], kept: list[str]) -> None:
    ignored = Ignored(patterns)
    assert [path for path in (*left_out, *kept) if ignored(path)] == left_out


@given(st.text(alphabet="ab*?[]^!-\\/.\n|&~(){}+$", max_size=60), st.text(alphabet="ab/.*", max_size=30))
def test_no_pattern_makes_it_fail_otherwise(patterns: str, path: str) -> None:
    try:
        found = Ignored(patterns)(path)
    except TaskError:
        return
    assert isinstance(found, bool)


def test_patterns_that_would_take_for_ever_are_refused() -> None:
    with pytest.raises(TaskError, match="too much in it"):
        Ignored("*a" * 30)
