"""What a task does to a machine before a step and before its verifier."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from memory_backend import plain_task

from gem_terminal.backends.interface import Completed
from gem_terminal.command import check_command
from gem_terminal.errors import MachineError, MachineLostError
from gem_terminal.tasks.staging import collect, stage, wait_until_healthy
from gem_terminal.tasks.task import Collect, Healthcheck, Solution, Step, Verifier
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


@pytest.mark.parametrize(("workdir", "path"), [("/app", "/app/a/b"), ("/", "/a/b")])
def test_a_step_brings_its_files_to_the_working_directory(workdir: str, path: str) -> None:
    """And its command is run there, with a limit; one that brings nothing asks for nothing."""
    recorder: Any = Recorder(workdir=workdir)
    stage(recorder, step())
    assert recorder.asked == []
    stage(recorder, step(files={"a/b": Path("/x")}))
    assert recorder.asked == [(("pwd",), {"timeout_s": 60.0}), {path: Path("/x")}]
    recorder.asked.clear()
    stage(recorder, step(files={"a/b": Path("/x")}, setup=("bash", "setup.sh")))
    setup = (("bash", "setup.sh"), {"workdir": workdir, "timeout_s": 600.0})
    assert recorder.asked == [(("pwd",), {"timeout_s": 60.0}), {path: Path("/x")}, setup]


@pytest.mark.parametrize(("exit_code", "how"), [(3, "exit code 3"), (None, "took too long")])
def test_a_command_that_fails_is_the_machines_failure(exit_code: int | None, how: str) -> None:
    """With what it said; never a reward of 0."""
    recorder: Any = Recorder(exit_code=exit_code)
    with pytest.raises(MachineError, match=f"'bash setup.sh' .*{how}:\nwhat it said"):
        stage(recorder, step(setup=("bash", "setup.sh")))


def test_commands_before_the_verifier_are_run_and_told_of() -> None:
    """One that fails is no error: its file is missing, which the verifier judges."""
    verifier = Verifier({}, ("true",), 1.0, "output", collect=(Collect(("dump",), 5.0, "root"), Collect(("more", "x"))))
    recorder: Any = Recorder(exit_code=None)
    said = [{"command": "dump", "exit_code": None}, {"command": "more x", "exit_code": None}]
    assert collect(recorder, verifier) == said
    how = [{"user": "root", "timeout_s": 5.0}, {"user": "", "timeout_s": 60.0}]
    assert recorder.asked == [(("dump",), how[0]), (("more", "x"), how[1])]


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

    def check(self, _: object) -> None:
        """Take any task."""

    def start(self, *_: object) -> contextlib.nullcontext[None]:
        """Start one."""
        return contextlib.nullcontext()


def test_check_makes_each_step_ready_before_it_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without and with the reference solution."""
    done: list[str] = []

    def does(what: str, result: object) -> Any:
        def do(*given: object, **_: object) -> object:
            done.extend(f"{what} {one.name}" for one in given if isinstance(one, Step))
            return result

        return do

    solved = step(solution=Solution(command=("true",)))
    task = replace(plain_task(), steps=(replace(solved, name="one"), solved))
    monkeypatch.setattr(check_command, "select_tasks", lambda *_: [task])
    monkeypatch.setattr(check_command, "chosen_backend", lambda *_: Room())
    for what, result in (("stage", None), ("solve", Completed(0, b"")), ("verify", Verdict(True, 1.0))):
        monkeypatch.setattr(check_command, what, does(what, result))
    # As gem calls it: click keeps the option of the first call.
    CliRunner().invoke(check_command.command, [], help_option_names=["-h", "--help"])
    solves = [f"{what} {name}" for name in ("one", "two") for what in ("stage", "solve", "verify")]
    assert done == [*(said for said in solves if "solve" not in said), *solves]
