"""A machine of a few dictionaries, for the course of a verification: what it is asked for, and in which order."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Self

from gem_terminal.backends.interface import Backend, Completed, Limits, Machine
from gem_terminal.errors import MachineLostError
from gem_terminal.tasks.task import Container, Environment, Solution, Step, Task, Verifier

if TYPE_CHECKING:
    Tests = Callable[["ToyMachine"], Completed]
    """What happens when a machine runs the tests."""

DONE = Completed(0, b"")


class ToyMachine:
    """Files, and a record of what was done.

    Args:
        tests: What its tests do.
        name: Its name in ``log``.
        log: What was done, by all machines of one backend.
    """

    def __init__(self, tests: Tests, name: str = "agent", log: list[str] | None = None) -> None:
        self.id = name
        self.tests = tests
        self.log = [] if log is None else log
        self.files: dict[str, bytes] = {}
        self.commands: list[tuple[str, ...]] = []
        self.said: dict[str, Any] = {}
        self.lost: MachineLostError | None = None
        self.removed = False

    def run(self, command: Sequence[str], **more: Any) -> Completed:
        self.commands.append(tuple(command))
        if command[0] in ("pwd", "prepare"):
            self.log.append(f"{self.id}: {command[0]}")
            return Completed(0, b"/app\n")
        self.log.append(f"{self.id}: tests")
        self.said = more
        return self.tests(self)

    def put(self, files: Mapping[str, Path | bytes | None], *, mode: int | None = None) -> None:
        for path, content in files.items():
            self.remove_files([path])
            if isinstance(content, bytes):
                self.files[path] = content
            elif content is None:
                continue
            elif content.is_file():
                self.files[path] = content.read_bytes()
            else:
                inside = [file for file in content.rglob("*") if file.is_file()]
                self.files |= {f"{path}/{file.relative_to(content)}": file.read_bytes() for file in inside}

    def get(self, path: str, *, most_bytes: int = 10_000_000) -> dict[str, bytes]:
        found = {}
        for name, content in self.files.items():
            if (name == path or name.startswith(path + "/")) and len(content) <= most_bytes:
                found[name[len(path) :].lstrip("/")] = content
        return found

    def save(self, path: str, file: BinaryIO, *, most_bytes: int) -> bool:
        found = self.get(path)
        self.log.append(f"{self.id}: save {path}")
        if sum(map(len, found.values())) > most_bytes:
            raise MachineLostError(f"{path} is larger than {most_bytes} bytes", by_agent=True)
        with tarfile.open(fileobj=file, mode="w") as tar:
            for name, content in found.items():
                info = tarfile.TarInfo(f"{path.rpartition('/')[2]}/{name}".rstrip("/"))
                info.size = len(content)
                tar.addfile(info, io.BytesIO(content))
        return bool(found)

    def load(self, path: str, file: BinaryIO) -> None:
        self.remove_files([path])
        with tarfile.open(fileobj=file) as tar:
            for member in tar.getmembers():
                if member.isfile():
                    content = tar.extractfile(member)
                    assert content is not None
                    self.files[f"{path}/{member.name.partition('/')[2]}".rstrip("/")] = content.read()

    def remove_files(self, paths: Sequence[str]) -> None:
        gone = [name for name in self.files if any(name == path or name.startswith(path + "/") for path in paths)]
        for name in gone:
            del self.files[name]

    def why_lost(self) -> MachineLostError | None:
        return self.lost

    def remove(self) -> None:
        self.removed = True
        self.log.append(f"{self.id}: gone")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()


class ToyBackend:
    """Starts machines whose tests do what they are told.

    Args:
        tests: What tests do on an untouched machine.
    """

    name = "toy"

    def __init__(self, tests: Tests) -> None:
        self.tests = tests
        self.log: list[str] = []
        self.started: list[ToyMachine] = []
        self.environments: list[Environment | None] = []

    def start(self, task: Task, limits: Limits, *, environment: Environment | None = None) -> ToyMachine:
        machine = ToyMachine(self.tests, "fresh", self.log)
        self.started.append(machine)
        self.environments.append(environment)
        self.log.append("start")
        return machine


def as_machine(machine: ToyMachine) -> Machine:
    """Return it as what it stands for; the terminal, which no verification opens, is left out."""
    return machine  # type: ignore[return-value]


def as_backend(backend: ToyBackend) -> Backend:
    """Return it as what it stands for."""
    return backend  # type: ignore[return-value]


def verifier(tmp_path: Path, **more: Any) -> Verifier:
    """Make a verifier of Harbor's with one file."""
    folder = tmp_path / "tests"
    folder.mkdir(exist_ok=True)
    (folder / "test.sh").write_text("echo 1 > /logs/verifier/reward.txt\n")
    said = {
        "files": {"/tests": folder},
        "command": ("bash", "/tests/test.sh"),
        "timeout_s": 5.0,
        "result": "reward_file",
    }
    return Verifier(**(said | more))  # type: ignore[arg-type]


def task(tmp_path: Path, one: Verifier, *, solution: Solution | None = None, steps: int = 1, **step: Any) -> Task:
    """Make a task of one verifier, the same for each step."""
    made = tuple(Step(f"step{n}", "do it", one, solution=solution, **step) for n in range(steps))
    return Task("toy", tmp_path, "harbor", Environment(Container()), made, str(tmp_path))
