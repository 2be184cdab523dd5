"""``gem terminal check``: the reference solution of a task must pass, and doing nothing must fail."""

from __future__ import annotations

import json
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, get_args

import click

from gem_core.progress import Progress
from gem_terminal.backends.interface import Limits
from gem_terminal.command.asking import chosen_backend, chosen_limits, paths_of, shared_options, why_not
from gem_terminal.errors import MachineError, TaskError
from gem_terminal.selecting import select_tasks
from gem_terminal.shell import Shell
from gem_terminal.tasks.staging import solve, stage
from gem_terminal.verifying.verify import Where, run_in_shell, verify

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend
    from gem_terminal.tasks.task import Task
    from gem_terminal.verifying.verdict import Verdict

_WIDTH = len("no_result") + 1
"""Of a column with a verdict in one word."""

_BY_HAND = Limits(cpus=1e6, memory_mb=2**30, processes=2**22, storage_mb=2**30)
"""As if somebody ran the task without GEM: all that there is, unless the task asks for less."""


@click.command(
    "check",
    epilog="""\b
Examples:
  gem terminal check
  gem terminal check my-tasks --task 'git-*'
  gem terminal check my-tasks --verify-in judge
  gem terminal check my-tasks/fix-the-server --json
""",
)
@shared_options
@click.option(
    "--network",
    type=click.Choice(["task", "none", "public"]),
    default="task",
    show_default=True,
    help="Network of the machine; 'task' is what the task asks for.",
)
@click.option("--task", "names", multiple=True, metavar="NAME", help="Only this task, or those of this pattern.")
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Tasks at once.")
@click.option(
    "--verify-in",
    type=click.Choice(get_args(Where)),
    default="machine",
    show_default=True,
    help="Where the tests run: where the solution did, or in a fresh machine.",
)
@click.option("--artifact", "artifacts", multiple=True, metavar="PATH", help="What a judge gets; see the environment.")
@click.option("--json", "as_json", is_flag=True, help="Write a line of JSON for each task, with its tests.")
@click.pass_context
def command(
    ctx: click.Context,
    /,
    where: tuple[str, ...],
    names: tuple[str, ...],
    jobs: int,
    verify_in: Where,
    artifacts: tuple[str, ...],
    as_json: bool,
    variables: tuple[str, ...],
    network: str,
    build_args: tuple[str, ...],
    **most: Any,
) -> None:
    """Try tasks: their reference solution must pass, and doing nothing must fail.

    PATH is a task's folder or a folder of tasks; an ID is one such as terminal:Sample, which is the default.
    Prints each task as soon as it has been tried. The exit code is 0 if all are sound.
    """
    tasks = select_tasks(paths_of(where), list(names) or None, variables)
    check = _Check(chosen_backend(build_args), chosen_limits(network, **most), verify_in, artifacts)
    name_width = max(len("task"), *(len(task.name) for task in tasks))
    if not as_json:
        _print("task", "solution", "nothing", "seconds", "verdict", name_width=name_width)
    sound = True
    quiet = not sys.stderr.isatty()  # the lines of the tasks tell how far it is
    with Progress(len(tasks), "tasks", quiet=quiet) as progress, ThreadPoolExecutor(jobs) as threads:
        try:
            for count, done in enumerate(as_completed([threads.submit(check.try_task, task) for task in tasks])):
                row = done.result()
                sound = sound and row["sound"]
                if as_json:
                    click.echo(json.dumps(row))
                else:
                    verdict = "sound" if row["sound"] else " ".join(row["why"].split())[:600]
                    cells = (row["task"], row["solution"], row["nothing"], f"{row['seconds']:.1f}", verdict)
                    _print(*cells, name_width=name_width)
                progress.advance(count + 1)
        except KeyboardInterrupt:
            check.stopped.set()
            threads.shutdown(wait=False, cancel_futures=True)
            check.backend.close()  # without their machines, the tasks that are being tried end at once
            raise
    if not sound:
        ctx.exit(1)


@dataclass
class _Check:
    """What all tasks are tried with."""

    backend: Backend
    limits: Limits
    where: Where
    artifacts: tuple[str, ...]
    stopped: threading.Event = field(default_factory=threading.Event)

    def try_task(self, task: Task) -> dict[str, Any]:
        """Return what there is to tell of a task."""
        began = time.monotonic()
        limits, by_hand = self.limits, replace(_BY_HAND, network=self.limits.network)
        row: dict[str, Any] = {"task": task.name, "solution": "-", "nothing": "-", "sound": False, "tests": []}
        if reason := why_not(self.backend, task):
            return row | {"why": f"cannot run here: {reason}", "seconds": 0.0}
        try:
            nothing, _, _ = self._verdict(task, limits, solved=False)
            row["nothing"] = _word(nothing)
            row["tests"] = [{"name": test.name, "passed_untouched": test.passed} for test in nothing.tests]
            why = "doing nothing passes" if nothing.passed else ""
            if all(step.solution is None for step in task.steps):
                why = why or "it has no reference solution"
            else:
                solution, output, how = self._verdict(task, limits, solved=True)
                row["solution"] = _word(solution)
                if not solution.passed:
                    if not how:
                        passes = self._verdict(task, by_hand, solved=True)[0].passed
                        how = "only under GEM's limits" if passes else "by hand too"
                    why = f"the reference solution fails {how}: {_reason(task, solution, output)}"
        except (MachineError, TaskError) as error:
            why = str(error)
        return row | {"sound": not why, "why": why, "seconds": round(time.monotonic() - began, 1)}

    def _verdict(self, task: Task, limits: Limits, *, solved: bool) -> tuple[Verdict, str, str]:
        """Return the verdict on the last step, or the first that does not pass.

        Returns:
            The verdict, the end of the solution's output, and where it fails alone; empty where that is not known.
        """
        output, how = "", ""
        with self.backend.start(task, limits) as machine:
            if self.stopped.is_set():
                raise MachineError("interrupted")
            artifacts = self.artifacts
            if self.where == "judge" and not artifacts:
                artifacts = (machine.run(["pwd"], timeout_s=60.0).output.decode().strip(),)
            for number, step in enumerate(task.steps):
                stage(machine, step)
                main = task.environment.main
                shell = Shell(machine, user=step.agent_user or main.user, workdir=main.workdir)
                if solved:
                    in_shell = shell if step.verifier.same_shell else None
                    output = solve(machine, step, shell=in_shell).output.decode(errors="replace")[-300:]
                judged = partial(
                    verify,
                    machine,
                    task,
                    step,
                    backend=self.backend,
                    limits=limits,
                    artifacts=artifacts,
                    control=False,
                    same_shell=partial(run_in_shell, machine, shell),
                )
                verdict = judged(where=self.where)
                if not verdict.passed and solved and self.where == "judge" and judged(where="machine").passed:
                    how = "only under judge"
                if not verdict.passed or number + 1 == len(task.steps):
                    return verdict, output, how
        raise TaskError(f"the task {task.name} has no steps")


def _word(verdict: Verdict) -> str:
    if verdict.problem is not None:
        return verdict.problem
    return "passes" if verdict.passed else "fails"


def _reason(task: Task, verdict: Verdict, output: str) -> str:
    """Say why a solution fails: the tests by name, or what it and they wrote at their end, and notes on the task."""
    failed = ", ".join(test.name for test in verdict.tests if not test.passed)[:200]
    reason = verdict.detail or failed or output or f"the score is {verdict.score:g}"
    said = " ".join(verdict.output.split())[-200:]
    ended = f"; the tests ended with: {said}" if said and not verdict.tests else ""
    return reason + ended + "".join(f" ({note})" for note in task.notes)


def _print(name: str, solution: str, nothing: str, seconds: str, verdict: str, *, name_width: int) -> None:
    click.echo(f"{name:{name_width}}  {solution:{_WIDTH}}  {nothing:{_WIDTH}}  {seconds:>7}  {verdict}")
