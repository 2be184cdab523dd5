"""A machine of a few dictionaries, for the course of a verification: what it is asked for, and in which order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from gem_terminal.backends.interface import Backend, Change, Completed, Limits, Machine, Process
from gem_terminal.tasks.task import Container, Environment, Solution, Step, Task, Verifier

if TYPE_CHECKING:
    from gem_terminal.errors import MachineLostError

Tests = Callable[["ToyMachine"], Completed]
"""What happens when a machine runs the tests."""

DONE = Completed(0, b"")


class ToyMachine:
    """Files and processes, and a record of what was done.

    Args:
        tests: What its tests do.
        name: Its name in ``log``.
        log: What was done, by all machines that came of one backend.
    """

    def __init__(self, tests: Tests, name: str = "agent", log: list[str] | None = None) -> None:
        self.id = name
        self.tests = tests
        self.log = [] if log is None else log
        self.files: dict[str, bytes] = {}
        self.image: dict[str, bytes] = {}
        self.names = b"sh\nbash\npython3\nlibc.so.6\npytest\n"
        self.changes: dict[str, Change] | None = {}
        self.left: list[Process] = []
        self.killed: list[Process] = []
        self.commands: list[tuple[str, ...]] = []
        self.env: Mapping[str, str] = {}
        self.lost: MachineLostError | None = None
        self.removed = False
        self.can_hide = False

    def run(self, command: Sequence[str], *, timeout_s: float, **more: Any) -> Completed:
        self.commands.append(tuple(command))
        if command[0] == "chmod":
            return DONE
        if "ls -1A" in command[-1]:
            self.log.append(f"{self.id}: list")
            return Completed(0, self.names)
        if command[0] == "/bin/pwd":
            return Completed(0, b"/app\n")
        if command[0] == "/sbin/ldconfig":
            self.log.append(f"{self.id}: ldconfig")
            return DONE
        self.log.append(f"{self.id}: tests")
        self.env = more.get("env") or {}
        return self.tests(self)

    def put(self, files: Mapping[str, Path | bytes], *, mode: int | None = None) -> None:
        for path, content in files.items():
            if isinstance(content, bytes):
                self.files[path] = content
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

    def remove_files(self, paths: Sequence[str]) -> None:
        self.log.append(f"{self.id}: remove {' '.join(paths)}")
        gone = [name for name in self.files if any(name == path or name.startswith(path + "/") for path in paths)]
        for name in gone:
            del self.files[name]

    def changed(self) -> Mapping[str, Change] | None:
        return self.changes

    def put_back(self, paths: Sequence[str]) -> list[str]:
        self.log.append(f"{self.id}: put back {' '.join(paths)}")
        return list(paths)

    def processes(self) -> list[Process]:
        return list(self.left)

    def kill(self, processes: Sequence[Process]) -> None:
        self.killed += processes

    def judge(
        self, network: str | None = None, *, user: str = "", prepare: Callable[[Machine], object] | None = None
    ) -> Machine:
        self.log.append(f"{self.id}: judge {network}{f' as {user}' if user else ''}")
        copy = ToyMachine(self.tests, "judge", self.log)
        copy.files, copy.changes, copy.left, copy.lost = dict(self.files), self.changes, list(self.left), self.lost
        if prepare is not None:
            prepare(as_machine(copy))
        self.log.append("judge: begins")
        return as_machine(copy)

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
    weaker = ""

    def __init__(self, tests: Tests) -> None:
        self.tests = tests
        self.log: list[str] = []
        self.started: list[ToyMachine] = []

    def start(self, task: Task, limits: Limits, *, environment: Environment | None = None) -> ToyMachine:
        machine = ToyMachine(self.tests, "own" if environment is not None else "untouched", self.log)
        self.started.append(machine)
        self.log.append(f"start {machine.id}")
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


def task(tmp_path: Path, one: Verifier, *, solution: Solution | None = None, steps: int = 1, digest: str = "") -> Task:
    """Make a task of one verifier, the same for each step."""
    made = tuple(Step(f"step{n}", "do it", one, solution=solution) for n in range(steps))
    return Task("toy", tmp_path, "harbor", Environment(Container()), made, digest or str(tmp_path))
