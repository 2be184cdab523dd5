"""The course of a verification: a place the agent has no hand in, the task's files, the tests, their result."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gem_core.errors import UsageError
from gem_terminal.backends.interface import Backend, Completed, Limits, Machine, Process
from gem_terminal.errors import MachineLostError
from gem_terminal.tasks.staging import collect, stage
from gem_terminal.verifying.controls import CONTROLS
from gem_terminal.verifying.guarded import Inventories, PutBack, names_of, put_back_rest, put_back_tools
from gem_terminal.verifying.output_parsers import parser_named
from gem_terminal.verifying.results import MOST_OUTPUT, read_result
from gem_terminal.verifying.verdict import Verdict

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Step, Task, Verifier

Where = Literal["auto", "machine", "judge"]
Tools = Literal["image", "agent"]
SameShell = Callable[[Sequence[str], float], Completed]
"""Runs a command in the agent's own shell, within seconds."""

LOGS = "/logs/verifier"
_TESTS = "/tests"
_MOST_ARTIFACTS = 200_000_000
_INVENTORIES = Inventories()


@dataclass(frozen=True)
class _Place:
    machine: Machine
    name: Literal["machine", "judge", "separate", "shell"]
    left: tuple[Process, ...]


class _Guard:
    """Puts back the tools of a verifier in the machine it is called with, and keeps what was put back."""

    def __init__(self, task: Task, backend: Backend, limits: Limits) -> None:
        self._task = task
        self._backend = backend
        self._limits = limits
        self.done = PutBack()

    def __call__(self, machine: Machine) -> None:
        self.done = put_back_tools(machine, self._untouched)

    def _untouched(self) -> frozenset[str]:
        def look() -> frozenset[str]:
            with self._backend.start(self._task, self._limits) as machine:
                return names_of(machine)

        return _INVENTORIES.get(f"{self._backend.name} {self._task.digest}", look)


def verify(
    machine: Machine,
    task: Task,
    step: Step,
    *,
    backend: Backend,
    limits: Limits,
    where: Where = "auto",
    control: bool = True,
    tools: Tools = "image",
    same_shell: SameShell | None = None,
) -> Verdict:
    """Run the tests of a step, and return what they say.

    The caller has closed the agent's shell. What can go wrong in the tests is part of the verdict, and never a success.

    Args:
        machine: Where the agent worked.
        task: The task.
        step: The step that is judged.
        backend: What the machine is from; starts others, for a verifier's own environment and for the trial that finds
            out who is to blame.
        limits: What those may take.
        where: ``"machine"`` runs the tests in the agent's machine; ``"judge"`` in a copy that what the agent left
            running cannot reach; ``"auto"`` chooses the copy if something was left, or could be without being seen. A
            verifier with an environment of its own runs there in any case.
        control: Whether, when there is no verdict, the same tests are tried on an untouched machine, once for each
            version of a task: if they give a verdict there, the agent is to blame, and else the task.
        tools: ``"image"`` puts back the programs that tests are run with (``protected.py`` lists them) where the agent
            changed them; ``"agent"`` leaves them, for tasks that are about one of them.
        same_shell: Runs a command in the agent's own shell, which then stays open. Used for a task that asks for it
            (``run_tests_in_same_shell``) and only then; the agent decides what a command means there, so that such a
            verdict is worth what the agent is. Without it those tests run in a fresh process, as all others do.

    Raises:
        TaskError: The task names a parser that is not known.
        MachineError: The machinery failed, whatever the agent did; but for a machine that is lost, which is a problem
            of the verdict.
    """
    if where not in ("auto", "machine", "judge"):
        raise UsageError(f"where={where!r} is not known; use 'auto', 'machine' or 'judge'.")
    if tools not in ("image", "agent"):
        raise UsageError(f"tools={tools!r} is not known; use 'image' or 'agent'.")
    if step.verifier.result == "output":
        parser_named(step.verifier.parser)
    verdict = _attempt(machine, task, step, backend, limits, where, tools, same_shell)
    if verdict.problem in (None, "machine") or not control:
        return verdict

    def attempt_untouched() -> Verdict:
        with backend.start(task, limits) as untouched:
            stage(untouched, step)
            return _attempt(untouched, task, step, backend, limits, "machine", "agent", None)

    tried = CONTROLS.get((task.digest, step.name, backend.name), attempt_untouched)
    if tried.problem == "machine":
        return replace(verdict, info={**verdict.info, "control": tried.problem})
    blame: Literal["agent", "task"] = "agent" if tried.problem is None else "task"
    return replace(verdict, blame=blame, info={**verdict.info, "control": tried.problem or "verdict"})


def _attempt(
    machine: Machine,
    task: Task,
    step: Step,
    backend: Backend,
    limits: Limits,
    where: Where,
    tools: Tools,
    same_shell: SameShell | None,
) -> Verdict:
    """Verify once; a machine that is lost is a problem of the verdict."""
    began = time.monotonic()
    info: dict[str, object] = {}
    with ExitStack() as stack:
        at = machine
        try:
            if step.verifier.collect:
                info["collected"] = collect(machine, step.verifier)
            guard = _Guard(task, backend, limits) if tools == "image" else None
            place = _place(machine, task, step, backend, limits, where, same_shell, stack, guard)
            at = place.machine
            info |= {"where": place.name, "left": sorted({process.command for process in place.left})[:20]}
            if guard is not None and place.name != "separate":
                done = put_back_rest(at, guard.done, folder=task.environment.main.workdir)
                info["put_back"] = done.shown
            before = place.left if at is machine else at.processes()
            _prepare(place, step.verifier)
            completed = _run(place, step.verifier, same_shell)
            if place.name == "machine" or step is task.steps[-1]:
                # What the tests left running must not write a result of its own any more. A copy shows the agent's
                # processes as well, which go on in a next step.
                known = {(process.pid, process.started) for process in before}
                at.kill([one for one in at.processes() if (one.pid, one.started) not in known])
            verdict = read_result(at, step.verifier, completed)
            if place.name in ("machine", "shell") and step is not task.steps[-1]:
                at.remove_files(_own_paths(step.verifier))  # the agent goes on here, and must not see them
        except MachineLostError as error:
            verdict = _lost(at, error)
    seconds = round(time.monotonic() - began, 3)
    return replace(verdict, info={**verdict.info, **info, "duration_s": seconds})


def _place(
    machine: Machine,
    task: Task,
    step: Step,
    backend: Backend,
    limits: Limits,
    where: Where,
    same_shell: SameShell | None,
    stack: ExitStack,
    guard: _Guard | None,
) -> _Place:
    """Choose where the tests run; what has to be made for it is removed with ``stack``."""
    verifier = step.verifier
    left = tuple(machine.processes())
    if verifier.environment is not None:
        own = stack.enter_context(backend.start(task, limits, environment=verifier.environment))
        for path in verifier.artifacts:
            _take(machine, own, path)
        return _Place(own, "separate", left)
    if verifier.same_shell and same_shell is not None:
        if guard is not None:
            guard(machine)
        return _Place(machine, "shell", left)
    network = verifier.network if verifier.network != task.environment.network else None
    if where == "judge" or (where == "auto" and (left or machine.can_hide or network is not None)):
        judge = machine.judge(network, user=verifier.user, prepare=guard)
        return _Place(stack.enter_context(judge), "judge", left)
    if guard is not None:
        guard(machine)
    return _Place(machine, "machine", left)


def _take(source: Machine, target: Machine, path: str) -> None:
    """Take a file or folder of the agent's to the same place in another machine; links are left behind."""
    root = path.rstrip("/")
    files = source.get(root, most_bytes=_MOST_ARTIFACTS)
    if files:
        target.put({f"{root}/{name}" if name else root: content for name, content in files.items()})


def _own_paths(verifier: Verifier) -> list[str]:
    return list(dict.fromkeys([_TESTS, LOGS, *verifier.files]))


def _prepare(place: _Place, verifier: Verifier) -> None:
    """Put the task's files where they belong, and make an empty folder for the result."""
    machine = place.machine
    # The image of an environment of its own may hold the tests.
    machine.remove_files([LOGS] if place.name == "separate" else _own_paths(verifier))
    with tempfile.TemporaryDirectory(prefix="gem-terminal-") as name:
        empty = Path(name, "verifier")
        empty.mkdir()
        machine.put({**verifier.files, LOGS: empty})
    # Whoever runs the tests must be able to write there, whatever the host's umask was.
    machine.run(["chmod", "0777", LOGS], user="root", timeout_s=60.0)


def _run(place: _Place, verifier: Verifier, same_shell: SameShell | None) -> Completed:
    if place.name == "shell" and same_shell is not None:
        return same_shell(verifier.command, verifier.timeout_s)
    # Nothing of the agent's is in its environment: it starts with the container's, and this.
    return place.machine.run(
        verifier.command,
        user=verifier.user,
        env=verifier.env,
        timeout_s=verifier.timeout_s,
        most_output=MOST_OUTPUT,
    )


def _lost(machine: Machine, error: MachineLostError) -> Verdict:
    """Say what a lost machine means: blame is the agent's only where it is known to be."""
    why = machine.why_lost() or error
    by_agent = error.by_agent or why.by_agent
    return Verdict(False, 0.0, problem="machine", blame="agent" if by_agent else None, detail=str(why))
