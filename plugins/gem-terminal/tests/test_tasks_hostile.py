"""Task folders from anywhere: the answer is a task or a ``TaskError``, and nothing outside of them is read."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from task_writing import HARBOR, TERMINAL_BENCH, read_task, write

from gem_terminal.errors import TaskError
from gem_terminal.tasks.folders import find_tasks
from gem_terminal.tasks.reading import MOST_BYTES

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + level)}: &{chr(98 + level)} [{', '.join(['*' + chr(97 + level)] * 9)}]\n" for level in range(12)
)
"""Nine to the power of thirteen values in 700 bytes."""
MERGES = "a: &a {x: 1}\n" + "".join(
    f"{chr(98 + level)}: &{chr(98 + level)} {{<<: [{', '.join(['*' + chr(97 + level)] * 9)}]}}\n" for level in range(12)
)
"""The same of merge keys, which copy what they merge."""


def refused(folder: Path) -> str:
    """Return the error of a task that cannot be read."""
    with pytest.raises(TaskError) as raised:
        read_task(folder)
    return str(raised.value)


DEEP, MANY = "nested too deeply", "more than 50,000 values"
HOSTILE = {
    "bomb": (BOMB, MANY),
    "merge": (MERGES, MANY),
    "itself": ("a: &a [*a]\n", DEEP),
    "deep": ("[" * 100_000, DEEP),
    "deeper": ("a: " + "[" * 60 + "]" * 60, DEEP),
    "many": ("- x\n" * 60_000, MANY),
    "keys": ("? " * 5_000, DEEP),
    "large": ("x" * (MOST_BYTES + 1), "1,000,001 bytes"),
    "base-60": ("a: 1" + ":1" * 1_000, "base 60"),
    "zero": ("a: \0", "zero byte"),
    "object": ("a: !!python/object/apply:os.system [true]", "no valid YAML"),
    "tag": ("a: !!bool x", "no valid YAML"),
}


@pytest.mark.few(12)
@pytest.mark.parametrize("file", ["task.yaml", "solution.yaml"])
@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_yaml_is_refused(tmp_path: Path, file: str, case: str) -> None:
    """Before anything is made of it."""
    text, problem = HOSTILE[case]
    folder = write(tmp_path / "t", TERMINAL_BENCH, {file: text})
    message = refused(folder)
    assert message.startswith(f"{folder}/{file}: ")
    assert problem in message


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 20_000, "a = " + "9" * 10_000, "a." * 20_000 + "b = 1", "[metadata]\na = " + "{a = " * 300],
    ids=["deep", "digits", "dots", "tables"],
)
def test_hostile_toml_is_refused(tmp_path: Path, text: str) -> None:
    """Nesting and numbers without end."""
    folder = write(tmp_path / "t", HARBOR, {"task.toml": text})
    assert refused(folder).startswith(f"{folder}/task.toml: ")


@pytest.mark.parametrize("field", ["[metadata]\na", "[agent]\ntimeout_sec", "[environment]\ncpus", "new"])
def test_numbers_that_cannot_be_written_are_refused(tmp_path: Path, field: str) -> None:
    """Python reads a hexadecimal number of any length, and then cannot show it."""
    folder = write(tmp_path / "t", HARBOR, {"task.toml": f"{field} = 0x{'f' * 20_000}\n"})
    assert "80,000 bits" in refused(folder)


def test_metadata_is_plain_or_refused(tmp_path: Path) -> None:
    """What is nested within reason is kept; what is not is an error."""
    deep = "[metadata]\na = " + "[" * 60 + "]" * 60 + "\n"
    folder = write(tmp_path / "t", HARBOR, {"task.toml": deep})
    assert DEEP in refused(folder)
    text = "[metadata]\ntags = [inf, nan, 1.5, 07:32:00, 1979-05-27T07:32:00Z]\n"
    kept = read_task(write(tmp_path / "t", HARBOR, {"task.toml": text})).tags
    assert kept == ("inf", "nan", "1.5", "07:32:00", "1979-05-27T07:32:00+00:00")


def test_variables_cannot_grow_without_end(tmp_path: Path) -> None:
    """A long value in many places."""
    files = {
        ".env": "A=" + "x" * 100_000,
        "docker-compose.yaml": "services: {client: {build: ., user: '" + "$A" * 100_000 + "'}}\n",
    }
    folder = write(tmp_path / "t", TERMINAL_BENCH, files)
    assert "longer than two million characters" in refused(folder)
    nested = "services: {client: {build: ., user: '" + "${A:-" * 5_000 + "'}}\n"
    folder = write(tmp_path / "t", TERMINAL_BENCH, {"docker-compose.yaml": nested})
    assert "has variables nested too deeply; expected 20 levels at most." in refused(folder)


@pytest.mark.parametrize(
    "file", ["task.yaml", "run-tests.sh", "tests", "Dockerfile", "tests/data", "solution.sh", ".env"]
)
@pytest.mark.parametrize("target", ["/etc/passwd", "../../outside", "../../../../etc", "/nowhere"])
def test_links_that_lead_out_are_refused(tmp_path: Path, file: str, target: str) -> None:
    """Whichever file it is, and whether the target is there or not."""
    left_out: dict[str, str | bytes | None] = {
        file: None,
        **({"tests/test_outputs.py": None} if file == "tests" else {}),
    }
    folder = write(tmp_path / "t", TERMINAL_BENCH, left_out)
    (folder / file).symlink_to(target)
    assert refused(folder).startswith(f"{folder / file}: is a link to {target!r}, out of {folder}")


def test_links_inside_are_followed_and_circles_are_errors(tmp_path: Path) -> None:
    """A link from one file of the task to another is what it points to."""
    folder = write(tmp_path / "t", HARBOR, {"instruction.md": None, "README.md": "Do it."})
    (folder / "instruction.md").symlink_to("README.md")
    assert read_task(folder).steps[0].instruction == "Do it."
    (folder / "README.md").unlink()
    (folder / "README.md").symlink_to("instruction.md")
    assert refused(folder).startswith(f"{folder}/")


def test_a_task_that_is_a_link_is_no_task_of_the_folder(tmp_path: Path) -> None:
    """It may lead anywhere; named itself, it is read."""
    write(tmp_path / "elsewhere/one", HARBOR)
    write(tmp_path / "set/two", HARBOR)
    (tmp_path / "set/one").symlink_to("../elsewhere/one")
    assert [task.name for task in find_tasks([tmp_path / "set"]).tasks] == ["two"]
    assert read_task(tmp_path / "set/one").folder == tmp_path / "elsewhere/one"


def test_pipes_and_sockets_are_refused_without_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening a pipe would wait for somebody to write."""
    folder = write(tmp_path / "t", HARBOR, {"instruction.md": None})
    os.mkfifo(folder / "instruction.md")
    assert refused(folder) == f"{folder}/instruction.md: is neither a file nor a folder; remove it."
    (folder / "instruction.md").unlink()
    monkeypatch.chdir(folder)  # the name of a socket must be short
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind("instruction.md")
        assert refused(folder) == f"{folder}/instruction.md: is neither a file nor a folder; remove it."


def test_a_file_of_a_gigabyte_is_not_read_as_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its size is enough for the error; one byte more than the limit is all that is read."""
    folder = write(tmp_path / "t", HARBOR)
    monkeypatch.setattr("gem_terminal.tasks.reading.scan", lambda folder: "not hashed, which takes its time")
    with (folder / "instruction.md").open("r+b") as opened:
        opened.truncate(1 << 30)
    assert "1,073,741,824 bytes" in refused(folder)


@pytest.mark.parametrize("junk", [b"\x7fELF\x02\x01\x01\xff\xfe", "One.".encode("utf-16"), b"One.\0"])
@pytest.mark.parametrize("file", ["instruction.md", "task.toml", "environment/docker-compose.yaml"])
def test_binary_junk_is_refused(tmp_path: Path, file: str, junk: bytes) -> None:
    """Where text is expected."""
    folder = write(tmp_path / "t", HARBOR, {file: junk})
    message = refused(folder)
    assert message.startswith(f"{folder}/{file}: ")
    assert "expected a text file in UTF-8" in message


def test_a_folder_where_a_file_belongs_is_an_error(tmp_path: Path) -> None:
    """And the other way round."""
    folder = write(tmp_path / "t", HARBOR, {"task.toml": None, "task.toml/x": ""})
    assert refused(folder).startswith(f"{folder}")
    folder = write(tmp_path / "u", HARBOR, {"tests/test.sh": None, "tests": ""})
    assert refused(folder) == f"{folder}/tests/test.sh: the file is missing; expected the script that judges."


def test_a_file_that_may_not_be_read_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not a crash; as root may read everything, the system's answer is put in its place."""
    folder = write(tmp_path / "t", HARBOR)
    real = Path.open

    def deny(path: Path, how: str) -> object:
        if path == folder / "instruction.md":
            raise PermissionError(13, "Permission denied")
        return real(path, how)

    monkeypatch.setattr(Path, "open", deny)
    assert refused(folder) == f"{folder}/instruction.md: cannot be read: Permission denied."


def read_or_refuse(files: dict[str, str | bytes | None], base: dict[str, str]) -> Task | None:
    """Read a task of any contents; anything but a task or a ``TaskError`` is a failure of the test."""
    with TemporaryDirectory() as name:
        folder = write(Path(name).resolve() / "t", base, files)
        task, message = None, ""
        try:
            task = read_task(folder)
        except TaskError as error:
            message = str(error)
        if task is None:
            assert str(folder) in message
            assert message.endswith((".", ")"))
            return None
        for container in (task.environment.main, *task.environment.services.values()):
            assert container.context is None or container.context.is_relative_to(folder)
        for step in task.steps:
            assert all(file.is_relative_to(folder) for file in step.verifier.files.values())
        return task


_WORDS = """
services client main build image . .. / /etc x a:b ${A} ${A:-b $$ environment volumes command depends_on networks
healthcheck test deploy resources limits memory cpus 1g 0 -1 true null ~ *a &a <<: instruction version steps name
timeout_sec environment_mode separate verifier agent metadata env_file .env user 1e400 !!int profiles
"""
WORDS = st.sampled_from(_WORDS.split())
VALUES = st.recursive(
    WORDS | st.text(max_size=8) | st.integers() | st.floats() | st.none() | st.booleans(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=4),
    max_leaves=12,
)
_SERVICE_KEYS = """
build image command entrypoint environment env_file depends_on healthcheck working_dir user hostname networks
network_mode volumes tmpfs deploy cpus mem_limit shm_size profiles scale privileged cap_add container_name
"""
SERVICE_KEYS = _SERVICE_KEYS.split()
FUZZ = settings(suppress_health_check=[HealthCheck.too_slow])


@FUZZ
@given(st.lists(WORDS | st.text(max_size=5), max_size=30), st.sampled_from([" ", "\n", ": ", "\n  "]))
@example(["services:", "{client:", "{build:", ".}}"], " ")
def test_any_yaml_is_a_task_or_a_task_error(words: list[str], joint: str) -> None:
    """In each of the files."""
    text = joint.join(words).encode("utf-8", "surrogatepass")
    for file in ("task.yaml", "docker-compose.yaml", "solution.yaml", ".env", "test_weights.json"):
        read_or_refuse({file: text}, dict(TERMINAL_BENCH))


@FUZZ
@given(st.dictionaries(st.sampled_from(SERVICE_KEYS), VALUES, max_size=5), st.booleans())
def test_any_service_is_a_task_or_a_task_error(service: dict[str, object], other: bool) -> None:
    """JSON is YAML, so that every value arrives."""
    services = {"client": {"build": "."}, "other": service} if other else {"client": service}
    text = json.dumps({"services": services}, ensure_ascii=True)
    read_or_refuse({"docker-compose.yaml": text}, dict(TERMINAL_BENCH))


def _toml(value: object) -> str:
    """Write a value as TOML does, near enough: what is no TOML must be refused as well."""
    if isinstance(value, dict):
        return "{" + ", ".join(f'"{key}" = {_toml(part)}' for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(part) for part in value) + "]"
    if isinstance(value, str):
        return '"' + value.encode("unicode_escape").decode().replace("\\x", "\\u00").replace('"', '\\"') + '"'
    return str(value).lower()


_SECTION_KEYS = """
timeout_sec user network_mode allowed_hosts env environment_mode environment collect build_timeout_sec docker_image
os cpus memory_mb memory storage_mb storage gpus tpu mcp_servers healthcheck workdir allow_internet name min_reward
artifacts agent verifier command source service
"""
SECTION_KEYS = _SECTION_KEYS.split()
_SECTIONS = """
metadata agent verifier environment solution task steps artifacts multi_step_reward_strategy
"""
SECTIONS = _SECTIONS.split()


@FUZZ
@given(
    st.dictionaries(
        st.sampled_from(SECTIONS),
        VALUES | st.dictionaries(st.sampled_from(SECTION_KEYS), VALUES, max_size=4),
        max_size=4,
    )
)
@example({"steps": [{"name": "."}]})
@example({"environment": {"cpus": 0}})
def test_any_toml_is_a_task_or_a_task_error(data: dict[str, object]) -> None:
    """Keys of the format with any values."""
    text = "\n".join(f"{key} = {_toml(value)}" for key, value in data.items())
    read_or_refuse({"task.toml": text.encode("utf-8", "surrogatepass")}, dict(HARBOR))


@FUZZ
@given(st.binary(max_size=200), st.sampled_from(sorted(HARBOR)))
def test_any_bytes_are_a_task_or_a_task_error(junk: bytes, file: str) -> None:
    """In each of the files."""
    read_or_refuse({file: junk}, dict(HARBOR))
