"""``gem terminal check``: the reference solution of a task must pass, and doing nothing must fail."""

from __future__ import annotations

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import click

from gem_core.progress import Progress
from gem_terminal.backends.interface import Limits
from gem_terminal.command.asking import backend_options, chosen_backend, network_option, some_tasks, why_not
from gem_terminal.errors import MachineError, TaskError
from gem_terminal.tasks.staging import stage
from gem_terminal.verifying.solutions import solve
from gem_terminal.verifying.verify import verify

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend
    from gem_terminal.tasks.task import Task
    from gem_terminal.verifying.verdict import Verdict

_HEADERS = ("task", "solution", "nothing", "seconds", "verdict")


@click.command(
    "check",
    epilog="""\b
Examples:
  gem terminal check
  gem terminal check my-tasks --task 'git-*'
  gem terminal check my-tasks/fix-the-server --json
""",
)
@click.argument("where", nargs=-1, metavar="[PATH|ID]...")
@click.option("--task", "names", multiple=True, metavar="NAME", help="Only this task, or those of this pattern.")
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Tasks at once.")
@click.option("--json", "as_json", is_flag=True, help="Write one JSON list, with the tests of each.")
@network_option
@backend_options
@click.pass_context
def command(
    ctx: click.Context,
    where: tuple[str, ...],
    names: tuple[str, ...],
    jobs: int,
    as_json: bool,
    network: str,
    backend: str,
    build_args: tuple[str, ...],
) -> None:
    """Try tasks: their reference solution must pass, and doing nothing must fail.

    WHERE is a task's folder, a folder of tasks, or an id such as terminal:Sample, which is the default. The exit code
    is 0 when all tasks are sound.
    """
    tasks, chosen = some_tasks(where, names), chosen_backend(backend, build_args)
    limits, stopped = Limits(network=network), threading.Event()
    with Progress(len(tasks), "tasks", unit="tasks") as progress, ThreadPoolExecutor(jobs) as threads:
        rows = []
        try:
            for row in threads.map(lambda task: _checked(chosen, task, limits, stopped), tasks):
                rows.append(row)
                progress.advance(len(rows))
        except KeyboardInterrupt:
            stopped.set()
            threads.shutdown(wait=False, cancel_futures=True)
            chosen.close()  # without their machines, those that run come to their end at once
            raise
    if as_json:
        click.echo(json.dumps(rows, indent=1))
    else:
        _print(rows)
    if not all(row["sound"] for row in rows):
        ctx.exit(1)


def _checked(backend: Backend, task: Task, limits: Limits, stopped: threading.Event) -> dict[str, Any]:
    began = time.monotonic()
    row: dict[str, Any] = {"task": task.name, "solution": "-", "nothing": "-", "sound": False, "why": "", "tests": []}
    if reason := why_not(backend, task):
        return row | {"why": f"cannot run here: {reason}", "seconds": 0.0}
    try:
        nothing, _ = _tried(backend, task, limits, stopped, solved=False)
        row["nothing"] = _word(nothing)
        row["tests"] = [{"name": test.name, "passed_untouched": test.passed} for test in nothing.tests]
        why = "doing nothing passes" if nothing.passed else ""
        if all(step.solution is None for step in task.steps):
            why = why or "it has no reference solution"
        else:
            solution, said = _tried(backend, task, limits, stopped, solved=True)
            row["solution"] = _word(solution)
            if not solution.passed:
                reason = solution.detail or _failed(solution) or said or f"the score is {solution.score:g}"
                notes = "".join(f" ({note})" for note in task.notes)
                why = f"the reference solution fails: {reason}{_said_by_tests(solution)}{notes}"
    except (MachineError, TaskError) as error:
        why = str(error)
    return row | {"sound": not why, "why": why, "seconds": round(time.monotonic() - began, 1)}


def _tried(
    backend: Backend, task: Task, limits: Limits, stopped: threading.Event, *, solved: bool
) -> tuple[Verdict, str]:
    """Return the verdict of the last step, or of the first that does not pass, and the end of the solution's output."""
    with backend.start(task, limits) as machine:
        if stopped.is_set():
            raise MachineError("interrupted")
        said = ""
        for number, step in enumerate(task.steps):
            stage(machine, step)
            if solved:
                done = solve(machine, step)
                said = done.output.decode(errors="replace")[-300:]
            last = number + 1 == len(task.steps)
            verdict = verify(
                machine,
                task,
                step,
                backend=backend,
                limits=limits,
                where="auto" if last else "judge",
                control=False,
            )
            if last or not verdict.passed:
                return verdict, said
    raise TaskError(f"the task {task.name} has no steps")


def _word(verdict: Verdict) -> str:
    if verdict.problem is not None:
        return verdict.problem
    return "passes" if verdict.passed else "fails"


def _failed(verdict: Verdict) -> str:
    return ", ".join(test.name for test in verdict.tests if not test.passed)[:200]


def _said_by_tests(verdict: Verdict) -> str:
    """Return the end of what the tests said, where they name none that failed."""
    said = " ".join(verdict.output.split())[-200:]
    return f"; the tests ended with: {said}" if said and not verdict.tests else ""


def _print(rows: list[dict[str, Any]]) -> None:
    lines = [_HEADERS]
    for row in rows:
        verdict = "sound" if row["sound"] else " ".join(row["why"].split())[:600]
        lines.append((row["task"], row["solution"], row["nothing"], f"{row['seconds']:.1f}", verdict))
    widths = [max(len(line[column]) for line in lines) for column in range(len(_HEADERS))]
    for line in lines:
        click.echo("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
