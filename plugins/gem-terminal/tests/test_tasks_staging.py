"""What a task does to a machine before a step and before its verifier."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
from click.testing import CliRunner
from memory_backend import MemoryBackend, MemoryMachine, plain_task

from gem_terminal.backends.interface import Completed, Machine
from gem_terminal.command import check_command
from gem_terminal.errors import MachineError, MachineLostError
from gem_terminal.tasks.staging import collect, stage, wait_until_healthy
from gem_terminal.tasks.task import Collect, Healthcheck, Solution, Step, Task, Verifier
from gem_terminal.verifying.verdict import Verdict


class Recorder:
    """A machine that keeps what it is asked, and ends every command as it is told to."""

    def __init__(self, *, workdir: str = "/app", exit_code: int | None = 0) -> None:
        self.asked: list[object] = []
        self.workdir = workdir
        self.exit_code = exit_code

    def run(self, command: Sequence[str], **how: Any) -> Completed:
        self.asked.append((tuple(command), how))
        if list(command) == ["pwd"]:
            return Completed(0, f"{self.workdir}\n".encode())
        return Completed(self.exit_code, b"what it said\n")

    def put(self, files: Mapping[str, Path]) -> None:
        self.asked.append(dict(files))


def step(**more: Any) -> Step:
    """Return a step named ``two``."""
    return Step("two", "Do.", Verifier({}, ("true",), 1.0, "output"), **more)


def test_a_step_brings_its_files_to_the_working_directory() -> None:
    """And its command is run there, with a limit."""
    recorder = Recorder()
    stage(cast("Machine", recorder), step(files={"a/b": Path("/x")}, setup=("bash", "setup.sh")))
    assert recorder.asked == [
        (("pwd",), {"timeout_s": 60.0}),
        {"/app/a/b": Path("/x")},
        (("bash", "setup.sh"), {"workdir": "/app", "timeout_s": 600.0}),
    ]


def test_the_root_is_a_working_directory() -> None:
    """Without a second stroke in the path."""
    recorder = Recorder(workdir="/")
    stage(cast("Machine", recorder), step(files={"a": Path("/x")}))
    assert recorder.asked[1] == {"/a": Path("/x")}


def test_a_step_that_brings_nothing_asks_for_nothing() -> None:
    """As most do."""
    recorder = Recorder()
    stage(cast("Machine", recorder), step())
    assert recorder.asked == []


@pytest.mark.parametrize(("exit_code", "how"), [(3, "ended with exit code 3"), (None, "took too long")])
def test_a_command_that_fails_is_the_machines_failure(exit_code: int | None, how: str) -> None:
    """With what it said; never a reward of 0."""
    with pytest.raises(MachineError) as raised:
        stage(cast("Machine", Recorder(exit_code=exit_code)), step(setup=("bash", "setup.sh")))
    assert str(raised.value) == f"the command 'bash setup.sh' before the step 'two' {how}:\nwhat it said"


def test_commands_before_the_verifier_are_run_and_told_of() -> None:
    """One that fails is no error: its file is missing, which the verifier judges."""
    verifier = Verifier({}, ("true",), 1.0, "output", collect=(Collect(("dump",), 5.0, "root"), Collect(("more", "x"))))
    recorder = Recorder(exit_code=None)
    assert collect(cast("Machine", recorder), verifier) == [
        {"command": "dump", "exit_code": None},
        {"command": "more x", "exit_code": None},
    ]
    assert recorder.asked == [
        (("dump",), {"user": "root", "timeout_s": 5.0}),
        (("more", "x"), {"user": "", "timeout_s": 60.0}),
    ]


def test_a_healthcheck_is_tried_as_often_as_it_may_fail() -> None:
    """Failures in its first seconds do not count, and a time limit ends it."""
    codes = iter([1, 1, 0])
    wait_until_healthy(Healthcheck(("x",), 0.0, retries=3), lambda: Completed(next(codes), b""), "it", by_agent=None)
    tried: list[int] = []

    def fail() -> Completed:
        tried.append(1)
        return Completed(7, b"ill")

    for check in (Healthcheck(("x",), 0.0, retries=2), Healthcheck(("x",), 0.0, start_period_s=0.2, retries=1)):
        with pytest.raises(MachineLostError, match="exit code 7 ill"):
            wait_until_healthy(check, fail, "it", by_agent=None, until=time.monotonic() + 60)
    assert len(tried) > 4


class Room:
    """Starts machines that nothing is done with."""

    def check(self, _: Task) -> None:
        """Take any task."""

    def start(self, *_: object) -> contextlib.nullcontext[MemoryMachine]:
        """Start one."""
        return contextlib.nullcontext(MemoryMachine(MemoryBackend(), plain_task()))


def test_check_makes_each_step_ready_before_it_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without and with the reference solution."""
    done: list[str] = []

    def solves(_: Machine, one: Step, **__: object) -> Completed:
        done.append(f"solve {one.name}")
        return Completed(0, b"")

    def verifies(_: Machine, __: Task, one: Step, **___: object) -> Verdict:
        done.append(f"verify {one.name}")
        return Verdict(True, 1.0)

    solved = step(solution=Solution(command=("true",)))
    task = replace(plain_task(), steps=(replace(solved, name="one"), solved))
    monkeypatch.setattr(check_command, "select_tasks", lambda *_: [task])
    monkeypatch.setattr(check_command, "chosen_backend", lambda *_: Room())
    monkeypatch.setattr(check_command, "stage", lambda _, one: done.append(f"stage {one.name}"))
    monkeypatch.setattr(check_command, "solve", solves)
    monkeypatch.setattr(check_command, "verify", verifies)
    # As gem calls it: click keeps the option of the first call.
    CliRunner().invoke(check_command.command, [], help_option_names=["-h", "--help"])
    assert done == [
        *("stage one", "verify one", "stage two", "verify two"),
        *("stage one", "solve one", "verify one", "stage two", "solve two", "verify two"),
    ]
