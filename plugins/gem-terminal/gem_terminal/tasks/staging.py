"""What a task does to a machine around the agent's work: before a step, before its verifier, and as its solution.

No agent sees the reference solution; ``gem terminal check`` and tests of tasks run it.
"""

from __future__ import annotations

import base64
import io
import shlex
import tarfile
import time
from collections.abc import Callable
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING

from gem_terminal.backends.interface import Completed
from gem_terminal.errors import MachineError, MachineLostError, TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Machine
    from gem_terminal.shell import Shell
    from gem_terminal.tasks.task import Healthcheck, Solution, Step, Verifier

SETUP_TIMEOUT_S = 600.0
"""Seconds that the command before a step may take; the formats have no limit for it."""

_OUTPUT = "/gem-solution-output"
"""Where a solution writes; a file, as in the formats' own programs. The engine closes a pipe seconds after the command
has ended, and a server that the solution left running then fails when it writes its next line."""

SOLUTION_S = 600.0
"""Seconds that a reference solution may take."""


def stage(machine: Machine, step: Step) -> None:
    """Bring what a step brings, and run its command; to be called before the step's healthcheck.

    Raises:
        MachineError: The command failed, or took too long; has the end of its output.
    """
    if not step.files and not step.setup:
        return
    where = machine.run(["pwd"], timeout_s=60.0).output.decode("utf-8", "replace").strip() or "/"
    root = where.rstrip("/")
    if step.files:
        machine.put({f"{root}/{path}": file for path, file in step.files.items()})
    if not step.setup:
        return
    done = machine.run(step.setup, workdir=where, timeout_s=SETUP_TIMEOUT_S)
    if done.exit_code != 0:
        how = "took too long" if done.exit_code is None else f"ended with exit code {done.exit_code}"
        end = done.output[-2000:].decode("utf-8", "replace").strip()
        raise MachineError(f"the command {' '.join(step.setup)!r} before the step {step.name!r} {how}:\n{end}")


def wait_until_healthy(
    check: Healthcheck, attempt: Callable[[], Completed], what: str, *, by_agent: bool | None, until: float = inf
) -> None:
    """Try a healthcheck until it succeeds.

    Args:
        check: How often, and for how long.
        attempt: Tries it once.
        what: What is to be ready, for the error.
        by_agent: Whether its failure is the agent's doing, see ``MachineLostError``.
        until: Time of the monotonic clock after which it is not tried any more.

    Raises:
        MachineLostError: It has failed as often as it may.
    """
    began, failures = time.monotonic(), 0
    while True:
        done = attempt()
        if done.exit_code == 0:
            return
        failures += time.monotonic() - began > check.start_period_s
        if failures >= max(check.retries, 1) or time.monotonic() >= until:
            break
        time.sleep(max(0.05, min(check.interval_s, until - time.monotonic())))
    ended = "it took too long" if done.exit_code is None else f"exit code {done.exit_code}"
    said = " ".join(done.output.decode("utf-8", "replace").split())[-300:]
    words = " ".join(check.command)
    raise MachineLostError(
        f"{what} was not ready after {failures} tries of {words!r}: {ended} {said}", by_agent=by_agent
    )


def collect(machine: Machine, verifier: Verifier) -> list[dict[str, object]]:
    """Run the commands that leave in files what the verifier needs; to be called before artifacts are taken.

    One that fails is told of, and no error: its file is then missing, which the verifier judges, as in Harbor.

    Returns for ``info`` what was run, and its exit code, None where it took too long.
    """
    told: list[dict[str, object]] = []
    for one in verifier.collect:
        done = machine.run(one.command, user=one.user, timeout_s=one.timeout_s)
        told.append({"command": " ".join(one.command)[:200], "exit_code": done.exit_code})
    return told


def solve(machine: Machine, step: Step, *, shell: Shell | None = None) -> Completed:
    """Do what the reference solution of a step does, and remove its files.

    Lines to type run in one shell, one after another; the seconds that each may take bound their sum.

    Args:
        machine: A machine of the task.
        step: The step.
        shell: Runs it in this shell, whose variables and folder it then may change; None runs it by itself.

    Returns:
        What it did; an exit code of None where it ran out of time.

    Raises:
        TaskError: The step has no reference solution.
        MachineError: The machine is gone, or its engine does not answer.
    """
    solution = step.solution
    if solution is None or not (solution.command or solution.typed):
        raise TaskError(f"step {step.name!r} has no reference solution." if step.name else "no reference solution.")
    command = _command(solution)
    limit = min(SOLUTION_S, step.agent_timeout_s or SOLUTION_S)
    if solution.typed and not solution.command:
        limit = min(limit, sum(seconds for _, seconds in solution.typed))
    machine.put(solution.files)
    machine.put({_OUTPUT: b""}, mode=0o666)
    try:
        if shell is not None:
            exports = "".join(f"export {name}={shlex.quote(value)}\n" for name, value in solution.env.items())
            lines = shlex.join(solution.command) if solution.command else _script(solution.typed)
            result = shell.run(f"{exports}{{ {lines}\n}} >>{_OUTPUT} 2>&1", limit)
            return Completed(result.exit_code, machine.get(_OUTPUT).get("", b""))
        to_file = ("sh", "-c", f'exec "$@" >>{_OUTPUT} 2>&1', "sh", *command)
        done = machine.run(to_file, user=step.agent_user, env=solution.env, timeout_s=limit)
        return replace(done, output=done.output + machine.get(_OUTPUT).get("", b""))
    finally:
        machine.remove_files([*solution.files, _OUTPUT])


def as_command(step: Step) -> str | None:
    """Return a line for the agent's shell that unpacks the reference solution of a step, runs and removes it.

    None where there is no solution, or where the agent is a user who may not write where its files go.
    """
    solution = step.solution
    if solution is None or not (solution.command or solution.typed) or step.agent_user not in ("", "root"):
        return None
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        for path, file in solution.files.items():
            archive.add(file, path.lstrip("/"), filter=_of_root)
    given = " ".join(f"{name}={shlex.quote(value)}" for name, value in solution.env.items())
    paths = " ".join(shlex.quote(path) for path in solution.files)
    unpacked = f"echo {base64.b64encode(packed.getvalue()).decode()} | base64 -d | tar xzf - -C / && "
    ran = f"env {given} {shlex.join(_command(solution))}"
    return f"{unpacked}{ran}; rm -f {paths}" if paths else ran


def _of_root(file: tarfile.TarInfo) -> tarfile.TarInfo:
    """Give a file to the machine's root: whoever owns it here may be nobody there, and tar would fail."""
    file.uid = file.gid = 0
    file.uname = file.gname = ""
    return file


def _command(solution: Solution) -> tuple[str, ...]:
    return solution.command or ("bash", "-c", _script(solution.typed))


def _script(typed: tuple[tuple[str, float], ...]) -> str:
    """Make one script of the lines: each runs by ``eval`` in the same shell, and one that fails does not end it."""
    return "\n".join(f"eval {shlex.quote(line)}" for line, _ in typed)
