"""A machine of a few dictionaries, for the course of a verification: what it is asked for, and in which order."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Self

from memory_backend import plain_task

from gem_terminal.backends.interface import Completed
from gem_terminal.errors import MachineLostError
from gem_terminal.tasks.task import Environment, Step, Task, Verifier

if TYPE_CHECKING:
    Tests = Callable[["ToyMachine"], Completed]
    """What happens when a machine runs the tests."""


@dataclass
class ToyMachine:
    """Files, and a record of what was done.

    Args:
        tests: What its tests do.
        id: Its name in ``log``.
        log: What was done, by all machines of one backend.
    """

    tests: Tests
    id: str = "agent"
    log: list[str] = field(default_factory=list)
    files: dict[str, bytes] = field(default_factory=dict)
    commands: list[tuple[str, ...]] = field(default_factory=list)
    said: dict[str, Any] = field(default_factory=dict)
    lost: MachineLostError | None = None

    def run(self, command: Sequence[str], **more: Any) -> Completed:
        self.commands.append(tuple(command))
        if command[0] in ("pwd", "prepare"):
            self.log.append(f"{self.id}: {command[0]}")
            return Completed(0, b"/app\n")
        self.log.append(f"{self.id}: tests")
        self.said = more
        return self.tests(self)

    def put(self, files: Mapping[str, Path | bytes], *, mode: int | None = None) -> None:
        for path, content in files.items():
            self.remove_files([path])
            if isinstance(content, bytes):
                self.files[path] = content
            elif content is not None and content.is_file():
                self.files[path] = content.read_bytes()
            elif content is not None:
                inside = (file for file in content.rglob("*") if file.is_file())
                self.files |= {f"{path}/{file.relative_to(content)}": file.read_bytes() for file in inside}

    def get(self, path: str, *, most_bytes: int = 10_000_000) -> dict[str, bytes]:
        below = {name: content for name, content in self.files.items() if f"{name}/".startswith(f"{path}/")}
        return {name[len(path) :].lstrip("/"): content for name, content in below.items() if len(content) <= most_bytes}

    def save(self, path: str, file: BinaryIO, *, most_bytes: int) -> bool:
        found = self.get(path)
        if sum(map(len, found.values())) > most_bytes:
            raise MachineLostError(f"{path} is larger than {most_bytes} bytes", by_agent=True)
        pickle.dump(found, file)
        return bool(found)

    def load(self, path: str, file: BinaryIO) -> None:
        self.remove_files([path])
        self.files |= {f"{path}/{name}".rstrip("/"): content for name, content in pickle.load(file).items()}

    def remove_files(self, paths: Sequence[str]) -> None:
        for name in [name for name in self.files if any(f"{name}/".startswith(f"{path}/") for path in paths)]:
            del self.files[name]

    def why_lost(self) -> MachineLostError | None:
        return self.lost

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.log.append(f"{self.id}: gone")


@dataclass
class ToyBackend:
    """Starts machines whose tests do what they are told.

    Args:
        tests: What tests do on an untouched machine.
    """

    tests: Tests
    name: str = "toy"
    log: list[str] = field(default_factory=list)
    started: list[ToyMachine] = field(default_factory=list)
    environments: list[Environment | None] = field(default_factory=list)

    def start(self, task: Task, limits: object, *, environment: Environment | None = None) -> ToyMachine:
        self.started.append(ToyMachine(self.tests, "fresh", self.log))
        self.environments.append(environment)
        self.log.append("start")
        return self.started[-1]


def task(tmp_path: Path, *, steps: int = 1, step: Mapping[str, Any] = {}, **verifier: Any) -> Task:
    """Make a task whose steps have the same verifier, of Harbor's kind with one file."""
    folder = tmp_path / "tests"
    folder.mkdir(exist_ok=True)
    (folder / "test.sh").write_text("echo 1 > /logs/verifier/reward.txt\n")
    said = {"files": {"/tests": folder}, "command": ("bash", "/tests/test.sh"), "result": "reward_file"}
    one: Any = Verifier(**{**said, "timeout_s": 5.0, **verifier})
    made = tuple(Step(f"step{number}", "do it", one, **step) for number in range(steps))
    return replace(plain_task(digest=str(tmp_path)), steps=made)
