"""Images: built once for the same content, and errors of a build that say what to do."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest
from docker_machines import BASE, DOCKERFILE, SMALL, backend, make_task, needs_engine, run_label, say
from hypothesis import given
from hypothesis import strategies as st

from gem_terminal.backends.docker.contexts import read_context, with_label
from gem_terminal.errors import BuildError, EngineError
from gem_terminal.tasks.task import Container

if TYPE_CHECKING:
    from pathlib import Path

    from gem_terminal.backends.docker.backend import DockerBackend

__all__ = ["backend", "run_label"]
MARK = "LABEL org.gem-llm.terminal=layer"


def test_each_stage_begins_with_the_label() -> None:
    """After the whole instruction, and not inside of another that has the word in it."""
    text = "# syntax=x\nARG A\nFROM a AS b\nRUN echo \\\n# comment\nFROM c\nfrom d \\\n  AS e\n"
    text += "RUN cat <<EOF\nFROM f\nEOF\nFROM g"
    assert with_label(text) == (
        f"# syntax=x\nARG A\nFROM a AS b\n{MARK}\nRUN echo \\\n# comment\nFROM c\nfrom d \\\n  AS e\n{MARK}\n"
        f"RUN cat <<EOF\nFROM f\nEOF\nFROM g\n{MARK}\n"
    )


@given(st.text())
def test_any_dockerfile_keeps_its_lines(text: str) -> None:
    """The label is all that is added."""
    lines = [line for line in with_label(text).split("\n") if line != MARK]
    assert [line for line in lines if line] == [line for line in text.splitlines() if line]


def test_the_digest_tells_what_an_image_is_made_of(tmp_path: Path) -> None:
    """Contents, names, permissions, arguments and stage; not times, and not what is ignored."""
    make_task(tmp_path)
    (tmp_path / "data").write_text("1")
    (tmp_path / "log").write_text("1")
    (tmp_path / ".dockerignore").write_text("# comment\nlog\n")
    container = Container(context=tmp_path)
    first = read_context(container, {"BASE": "x", "OTHER": "y"})
    assert first.args == {"BASE": "x"}
    (tmp_path / "log").write_text("2")
    assert read_context(container, {"BASE": "x"}).digest == first.digest
    assert read_context(container, {"BASE": "z"}).digest != first.digest
    assert read_context(Container(context=tmp_path, target="t"), {"BASE": "x"}).digest != first.digest
    (tmp_path / "data").chmod(0o755)
    second = read_context(container, {"BASE": "x"})
    assert second.digest != first.digest
    (tmp_path / "data").write_text("2")
    assert read_context(container, {"BASE": "x"}).digest != second.digest


def test_a_missing_dockerfile_is_named(tmp_path: Path) -> None:
    """With where it was looked for."""
    with pytest.raises(BuildError, match="the files of an image cannot be read"):
        read_context(Container(context=tmp_path), {})


@needs_engine
def test_an_image_is_built_once_for_all_who_ask(backend: DockerBackend, tmp_path: Path, run_label: str) -> None:
    """In several threads at the same time, and never again for the same content."""
    task = make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV ONCE={run_label}\n")
    lines: list[str] = []
    lock = threading.Lock()

    def note(line: str) -> None:
        with lock:
            lines.append(line)

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(lambda _: backend.build(task, on_line=note), range(6)))
    assert sum(line.startswith("Successfully tagged") for line in lines) == 1
    lines.clear()
    backend.images.forget()
    backend.build(task, on_line=note)
    assert lines == []
    backend.build(task, fresh=True, on_line=note)
    assert not any("Using cache" in line for line in lines)
    assert any(line.startswith("Successfully tagged") for line in lines)


@needs_engine
def test_an_image_that_was_removed_is_built_again(backend: DockerBackend, tmp_path: Path, run_label: str) -> None:
    """At the next start, without anybody's doing."""
    task = make_task(tmp_path, dockerfile=f"{DOCKERFILE}ENV AGAIN={run_label}\n")
    backend.start(task, SMALL).remove()
    for name in backend.images.names():
        if f"AGAIN={run_label}" in backend.engine.client.image(name)["Config"]["Env"]:
            backend.engine.client.remove_image(name, force=True)
    with backend.start(task, SMALL) as machine:
        assert say(machine, "echo $AGAIN") == f"{run_label}\n"


@needs_engine
def test_a_build_that_fails_ends_with_its_log(backend: DockerBackend, tmp_path: Path) -> None:
    """And leaves no layer."""
    task = make_task(tmp_path, dockerfile="ARG BASE\nFROM ${BASE}\nRUN echo one-$((40+2))\nRUN echo bad; exit 9\n")
    with pytest.raises(
        BuildError, match=r"returned a non-zero code: 9\. Mend its Dockerfile\. The end of the log"
    ) as caught:
        backend.build(task)
    assert "one-42" in caught.value.log
    assert caught.value.log.splitlines()[-1].endswith("returned a non-zero code: 9")


@needs_engine
@pytest.mark.thorough
def test_a_build_that_takes_too_long_is_ended(backend: DockerBackend, tmp_path: Path) -> None:
    """Also when it says nothing; what ran for it runs no more."""
    dockerfile = "ARG BASE\nFROM ${BASE}\nRUN echo begin; sleep 1234\n"
    task = make_task(tmp_path, dockerfile=dockerfile, build_timeout_s=5)
    with pytest.raises(BuildError, match=r"took longer than 5 s\. Raise the task's build_timeout_sec"):
        backend.build(task)
    client = backend.engine.client
    for _ in range(1000):
        if not any("sleep 1234" in row["Command"] for row in client.containers(all=True)):
            return
    pytest.fail("the build goes on")


@needs_engine
def test_a_missing_base_image_says_how_to_name_another(backend: DockerBackend, tmp_path: Path) -> None:
    """Nothing can be pulled here."""
    task = make_task(tmp_path, dockerfile="FROM 127.0.0.1:1/gem/none:latest\n")
    with pytest.raises(BuildError, match="Its base image is not there: 'docker pull' it, or name one with"):
        backend.build(task)


@needs_engine
def test_a_missing_image_says_how_to_get_it(backend: DockerBackend, tmp_path: Path) -> None:
    """One that the task names, and that is not built."""
    task = make_task(tmp_path, main=Container(image="127.0.0.1:1/gem/none:latest"))
    with pytest.raises(EngineError, match=r"Run 'docker pull 127\.0\.0\.1:1/gem/none:latest'"):
        backend.build(task)
    with backend.start(make_task(tmp_path, main=Container(image=BASE)), SMALL) as machine:
        assert say(machine, "echo fine") == "fine\n"


@needs_engine
def test_a_dockerfile_takes_the_place_of_an_image_that_is_missing(backend: DockerBackend, tmp_path: Path) -> None:
    """Which would come first: where it is there, nothing is built."""
    lines: list[str] = []
    dockerfile = f"{DOCKERFILE}ENV BUILT=yes\n"
    missing = Container(image="127.0.0.1:1/gem/none:latest", context=tmp_path)
    task = make_task(tmp_path, dockerfile=dockerfile, main=missing)
    backend.build(task, on_line=lines.append)
    assert any(line.startswith(f"building from {tmp_path / 'Dockerfile'} instead: the image") for line in lines)
    with backend.start(task, SMALL) as machine:
        assert say(machine, "echo $BUILT") == "yes\n"
    there = make_task(tmp_path, dockerfile=dockerfile, main=Container(image=BASE, context=tmp_path))
    with backend.start(there, SMALL) as machine:
        assert say(machine, "echo $BUILT") == "\n"
