"""Task folders from anywhere: the answer is a task or a ``TaskError``, and nothing outside of them is read."""

from __future__ import annotations

import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from task_writing import HARBOR, TERMINAL_BENCH, read_task, write

from gem_terminal.errors import TaskError
from gem_terminal.tasks.folders import find_tasks
from gem_terminal.tasks.reading import MOST_BYTES


def bomb(first: str, level: str) -> str:
    """Return nine to the power of thirteen values in 700 bytes; merge keys copy what they merge."""
    names = "abcdefghijklm"
    later = (f"{name}: &{name} {level.format(', '.join([f'*{names[at]}'] * 9))}\n" for at, name in enumerate(names[1:]))
    return f"a: &a {first}\n" + "".join(later)


def refused(folder: Path) -> str:
    """Return the error of a task that cannot be read."""
    with pytest.raises(TaskError) as raised:
        read_task(folder)
    assert str(raised.value).startswith(f"{folder}/")
    return str(raised.value)


DEEP, MANY = "nested too deeply", "more than 50,000 values"
YAML = [
    (bomb("[x, x, x, x, x, x, x, x, x]", "[{}]"), MANY),
    (bomb("{x: 1}", "{{<<: [{}]}}"), MANY),
    ("a: &a [*a]\n", DEEP),
    ("[" * 100_000, DEEP),
    ("a: " + "[" * 60 + "]" * 60, DEEP),
    ("- x\n" * 60_000, MANY),
    ("? " * 5_000, DEEP),
    ("x" * (MOST_BYTES + 1), "1,000,001 bytes"),
    ("a: 1" + ":1" * 1_000, "base 60"),
    ("a: \0", "zero byte"),
    ("a: !!python/object/apply:os.system [true]", "no valid YAML"),
    ("a: !!bool x", "no valid YAML"),
]
USER = "services: {{client: {{build: ., user: '{}'}}}}\n"
COMPOSE = [(USER.format("${A:-" * 5_000), DEEP), (USER.format("$A" * 100_000), "two million characters")]
TOML = [
    ("a = " + "[" * 20_000, ""),
    ("a = " + "9" * 10_000, ""),
    ("a." * 20_000 + "b = 1", ""),
    ("[metadata]\na = " + "{a = " * 300, ""),
    ("[metadata]\na = " + "[" * 60 + "]" * 60, DEEP),
    (f"[metadata]\na = 0x{'f' * 20_000}", "80,000 bits"),
    (f"[environment]\ncpus = 0x{'f' * 20_000}", "80,000 bits"),
]


@pytest.mark.parametrize(
    ("base", "file", "text", "problem"),
    [
        *((TERMINAL_BENCH, "task.yaml", *row) for row in YAML),
        (TERMINAL_BENCH, "solution.yaml", *YAML[0]),
        *((TERMINAL_BENCH, "docker-compose.yaml", *row) for row in COMPOSE),
        *((HARBOR, "task.toml", *row) for row in TOML),
        (HARBOR, "instruction.md", b"\x7fELF\x02\x01\x01\xff\xfe", "UTF-8"),
        (HARBOR, "task.toml", "One.".encode("utf-16"), "UTF-8"),
        (HARBOR, "environment/docker-compose.yaml", b"One.\0", "UTF-8"),
    ],
    ids=str,
)
def test_hostile_files_are_refused(tmp_path: Path, base: Any, file: str, text: str | bytes, problem: str) -> None:
    """Nesting, numbers, values and variables without end, objects, and junk."""
    folder = write(tmp_path / "t", base, {file: text, ".env": "A=" + "x" * 100_000})
    message = refused(folder)
    assert message.startswith(f"{folder}/{file}: ")
    assert problem in message


@pytest.mark.parametrize("file", ["task.yaml", "tests", "Dockerfile", "tests/data", "solution.sh", ".env"])
@pytest.mark.parametrize("target", ["/etc/passwd", "../../outside"])
def test_links_that_lead_out_are_refused(tmp_path: Path, file: str, target: str) -> None:
    """Whichever file it is, and whether the target is there or not."""
    left_out = {file: None, **({"tests/test_outputs.py": None} if file == "tests" else {})}
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
    refused(folder)


def test_a_task_that_is_a_link_is_no_task_of_the_folder(tmp_path: Path) -> None:
    """It may lead anywhere; named itself, it is read."""
    write(tmp_path / "elsewhere/one", HARBOR)
    write(tmp_path / "set/two", HARBOR)
    (tmp_path / "set/one").symlink_to("../elsewhere/one")
    assert [task.name for task in find_tasks([tmp_path / "set"]).tasks] == ["two"]
    assert read_task(tmp_path / "set/one").folder == tmp_path / "elsewhere/one"


def test_what_is_no_readable_file_is_refused_without_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening a pipe would wait for somebody to write; a gigabyte is not read; root may read everything."""
    folder = write(tmp_path / "t", HARBOR, {"instruction.md": None})
    file = folder / "instruction.md"
    os.mkfifo(write(tmp_path / "u", HARBOR) / "tests/pipe")
    assert "neither a file nor a folder" in refused(tmp_path / "u")
    os.mkfifo(file)
    assert "neither a file nor a folder" in refused(folder)
    file.unlink()
    file.mkdir()
    refused(folder)
    file.rmdir()
    monkeypatch.setattr("gem_terminal.tasks.reading.scan", lambda folder: "not hashed, which takes its time")
    with file.open("wb") as opened:
        opened.truncate(1 << 30)
    assert "1,073,741,824 bytes" in refused(folder)
    real = Path.open

    def deny(path: Path, how: str) -> object:
        if path == file:
            raise PermissionError(13, "Permission denied")
        return real(path, how)

    file.write_text("Do it.")
    monkeypatch.setattr(Path, "open", deny)
    assert "Permission denied" in refused(folder)


def read_or_refuse(file: str, content: bytes, base: Any) -> None:
    """Read a task of any contents; anything but a task or a ``TaskError`` is a failure of the test."""
    with TemporaryDirectory() as name:
        folder = write(Path(name).resolve() / "t", base, {file: content})
        try:
            task = read_task(folder)
        except TaskError:
            return
        for container in (task.environment.main, *task.environment.services.values()):
            assert container.context is None or container.context.is_relative_to(folder)
        for step in task.steps:
            assert all(file.is_relative_to(folder) for file in step.verifier.files.values())


WORDS = """
services client main build image . .. / /etc x a:b ${A} ${A:-b $$ environment volumes command depends_on networks
healthcheck test deploy resources limits memory cpus 1g 0 -1 true null ~ *a &a <<: instruction version steps name
timeout_sec environment_mode separate verifier agent metadata env_file .env user 1e400 !!int profiles entrypoint
working_dir hostname network_mode tmpfs mem_limit shm_size scale privileged cap_add container_name solution task
artifacts multi_step_reward_strategy allowed_hosts env collect build_timeout_sec docker_image os memory_mb storage_mb
gpus tpu mcp_servers workdir allow_internet min_reward source service
""".split()  # noqa: SIM905 - words are read more easily so
WORD = st.sampled_from(WORDS)
VALUES = st.recursive(
    WORD | st.text(max_size=8) | st.integers() | st.floats() | st.none() | st.booleans(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORD, inner, max_size=4),
    max_leaves=12,
)
FUZZ = settings(suppress_health_check=[HealthCheck.too_slow])


@FUZZ
@given(st.dictionaries(WORD, VALUES, max_size=5))
def test_any_service_is_a_task_or_a_task_error(service: dict[str, object]) -> None:
    """JSON is YAML, so that every value arrives."""
    text = json.dumps({"services": {"client": {"build": "."}, "other": service}}, ensure_ascii=True)
    read_or_refuse("docker-compose.yaml", text.encode(), TERMINAL_BENCH)


def _toml(value: object) -> str:
    """Write a value as TOML does, near enough: what is no TOML must be refused as well."""
    if isinstance(value, dict):
        return "{" + ", ".join(f'"{key}" = {_toml(part)}' for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(part) for part in value) + "]"
    if isinstance(value, str):
        return '"' + value.encode("unicode_escape").decode().replace("\\x", "\\u00").replace('"', '\\"') + '"'
    return str(value).lower()


@FUZZ
@given(st.dictionaries(WORD, VALUES, max_size=4))
@example({"steps": [{"name": "."}]})
@example({"environment": {"cpus": 0}})
def test_any_toml_is_a_task_or_a_task_error(data: dict[str, object]) -> None:
    """Keys of the format with any values."""
    text = "\n".join(f'"{key}" = {_toml(value)}' for key, value in data.items())
    read_or_refuse("task.toml", text.encode("utf-8", "surrogatepass"), HARBOR)


@FUZZ
@given(st.binary(max_size=200), st.sampled_from(sorted(HARBOR)))
def test_any_bytes_are_a_task_or_a_task_error(junk: bytes, file: str) -> None:
    """In each of the files."""
    read_or_refuse(file, junk, HARBOR)
