"""Running the tests of a step: in the agent's machine, or in a fresh one with what the agent made."""

from __future__ import annotations

import shlex
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from gem_terminal.backends.interface import Backend, Completed, Limits, Machine
from gem_terminal.errors import MachineLostError
from gem_terminal.tasks.staging import collect, stage
from gem_terminal.verifying.output_parsers import parser_named
from gem_terminal.verifying.results import LOGS, MOST_OUTPUT, read_result
from gem_terminal.verifying.verdict import Verdict

if TYPE_CHECKING:
    from gem_terminal.shell import Shell
    from gem_terminal.tasks.task import Environment, Step, Task, Verifier

Where = Literal["machine", "judge"]
SameShell = Callable[[Sequence[str], float], Completed]
"""Runs a command in the agent's own shell, within seconds."""

_Key = tuple[str, str, str]
_trials: dict[_Key, str | None] = {}
"""The problem that the tests have on an untouched machine, None without one, by version of the task, step, backend."""
_locks: dict[_Key, threading.Lock] = {}


def verify(
    machine: Machine,
    task: Task,
    step: Step,
    *,
    backend: Backend,
    limits: Limits,
    where: Where = "machine",
    artifacts: Sequence[str] = (),
    control: bool = True,
    same_shell: SameShell | None = None,
) -> Verdict:
    """Run the tests of a step, and return what they say.

    Args:
        machine: Where the agent worked.
        task: The task.
        step: The step that is judged.
        backend: What the machine is from; starts others.
        limits: What those may take.
        where: ``"machine"`` runs the tests where the agent worked; ``"judge"`` in a fresh machine of the task, to which
            only artifacts are carried. A verifier with an environment or a network of its own gets a fresh machine in
            any case.
        artifacts: Paths that are carried where the task names none.
        control: Whether, when there is no verdict, the same tests are tried on an untouched machine, once for each
            version of a task: if they give a verdict there, the agent is to blame, and else the task.
        same_shell: Runs the tests of a task that asks for it (``run_tests_in_same_shell``), but not those in a judge.

    Raises:
        TaskError: The task names a parser that is not known.
        MachineError: An engine failed, whatever the agent did. A machine that is lost is a problem of the verdict.
    """
    if step.verifier.result == "output":
        parser_named(step.verifier.parser)
    verdict = _attempt(machine, task, step, backend, limits, where, artifacts, same_shell)
    if verdict.problem in (None, "machine") or not control:
        return verdict
    tried = _trial(task, step, backend, limits)
    blame: Literal["agent", "task"] | None = "agent" if tried is None else "task"
    return replace(
        verdict, blame=None if tried == "machine" else blame, info={**verdict.info, "control": tried or "verdict"}
    )


def run_in_shell(machine: Machine, shell: Shell, command: Sequence[str], timeout_s: float) -> Completed:
    """Run tests in a shell; their output goes to a file, since that of a shell is cut."""
    path = f"{LOGS}/output"
    result = shell.run(f"{shlex.join(command)} >{path} 2>&1", timeout_s)
    return Completed(result.exit_code, machine.get(path, most_bytes=MOST_OUTPUT).get("", result.note.encode()))


def _trial(task: Task, step: Step, backend: Backend, limits: Limits) -> str | None:
    """Return the problem of the tests on an untouched machine; of several threads one tries, and the others wait."""
    key = (task.digest, step.name, backend.name)
    with _locks.setdefault(key, threading.Lock()):
        if key not in _trials:
            with backend.start(task, limits) as untouched:
                stage(untouched, step)
                problem = _attempt(untouched, task, step, backend, limits, "machine", (), None).problem
            if problem == "machine":  # which says nothing of the task
                return problem
            _trials[key] = problem
        return _trials[key]


def _attempt(
    machine: Machine,
    task: Task,
    step: Step,
    backend: Backend,
    limits: Limits,
    where: Where,
    artifacts: Sequence[str],
    same_shell: SameShell | None,
) -> Verdict:
    """Verify once; a machine that is lost is a problem of the verdict."""
    began = time.monotonic()
    verifier = step.verifier
    info: dict[str, object] = {}
    at = machine
    with ExitStack() as stack:
        try:
            if verifier.collect:
                info["collected"] = collect(machine, verifier)
            environment = _environment(task, verifier, limits)
            if where == "judge" or environment is not None:
                info["where"] = "judge" if verifier.environment is None else "separate"
                judge = stack.enter_context(backend.start(task, limits, environment=environment))
                if verifier.environment is None:
                    stage(judge, step)
                at = judge  # from here on, the agent's work may end it
                most_bytes = int(2 * limits.share(task.environment.main).storage_mb * 2**20)
                for path in verifier.artifacts or (artifacts if verifier.environment is None else ()):
                    _carry(machine, at, path.rstrip("/"), most_bytes=most_bytes)
            else:
                info["where"] = "machine"
            at.put({**verifier.files, LOGS: None})
            if verifier.same_shell and same_shell is not None and at is machine:
                info["where"] = "shell"
                completed = same_shell(verifier.command, verifier.timeout_s)
            else:
                # Nothing of the agent's shell is in its environment: it starts with the container's, and this.
                completed = at.run(
                    verifier.command,
                    user=verifier.user,
                    env=verifier.env,
                    timeout_s=verifier.timeout_s,
                    most_output=MOST_OUTPUT,
                )
            verdict = read_result(at, verifier, completed)
            if at is machine and step is not task.steps[-1]:
                at.remove_files([*verifier.files, LOGS])  # the agent goes on here, and must not see them
        except MachineLostError as error:
            why = at.why_lost() or error
            blame: Literal["agent"] | None = "agent" if error.by_agent or why.by_agent else None
            verdict = Verdict(False, 0.0, problem="machine", blame=blame, detail=str(why))
    seconds = round(time.monotonic() - began, 3)
    return replace(verdict, info={**verdict.info, **info, "duration_s": seconds})


def _environment(task: Task, verifier: Verifier, limits: Limits) -> Environment | None:
    """Return the environment that the tests ask for; None where it is the agent's.

    One with another network than the agent's is an environment of its own: a running machine cannot be given another.
    """
    agents = task.environment.network or "none"
    if verifier.environment or limits.network != "task" or verifier.network in (None, agents):
        return verifier.environment
    return replace(task.environment, network=verifier.network, allowed_hosts=verifier.allowed_hosts)


def _carry(source: Machine, target: Machine, path: str, *, most_bytes: int) -> None:
    """Copy a file or folder of the agent's to the same place in another machine; nothing where there is none."""
    with tempfile.TemporaryFile() as file:
        if source.save(path, file, most_bytes=most_bytes):
            file.seek(0)
            target.load(path, file)
