"""``gem terminal build``: the images of tasks, before they are needed."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import click

from gem_core.progress import Progress
from gem_terminal.command.asking import backend_options, chosen_backend, some_tasks, why_not
from gem_terminal.errors import MachineError


@click.command(
    "build",
    epilog="""\b
Examples:
  gem terminal build
  gem terminal build my-tasks
  gem terminal build my-tasks --task 'git-*' --fresh
  gem terminal build my-tasks --build-arg BASE=python:3.12-slim-bookworm
""",
)
@click.argument("where", nargs=-1, type=click.Path(), metavar="[PATH|ID]...")
@click.option("--task", "names", multiple=True, metavar="NAME", help="Only this task, or those of this pattern.")
@click.option("--fresh", is_flag=True, help="Build anew, without caches.")
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Builds at once.")
@click.option("--verbose", is_flag=True, help="Show the whole log.")
@backend_options
@click.pass_context
def command(
    ctx: click.Context,
    where: tuple[str, ...],
    names: tuple[str, ...],
    fresh: bool,
    jobs: int,
    verbose: bool,
    backend: str,
    build_args: tuple[str, ...],
) -> None:
    """Build the images of tasks; those that are there already are left.

    PATH is a task's folder or a folder of tasks; an ID is one such as terminal:Sample, which is the default.
    """
    tasks, chosen = some_tasks(where, names), chosen_backend(backend, build_args)
    began = time.monotonic()
    failed: dict[str, MachineError] = {}
    skipped: dict[str, str] = {}

    def show(name: str, line: str) -> None:
        click.echo(f"{name}: {line.rstrip()}", err=True)

    def build(number: int) -> None:
        task = tasks[number]
        if reason := why_not(chosen, task):
            skipped[task.name] = reason
            return
        try:
            chosen.build(task, fresh=fresh, on_line=partial(show, task.name) if verbose else None)
        except MachineError as error:
            failed[task.name] = error

    with Progress(len(tasks), "images", unit="images") as progress, ThreadPoolExecutor(jobs) as threads:
        for done, _ in enumerate(threads.map(build, range(len(tasks))), 1):
            progress.advance(done, f"{len(failed)} failed" if failed else "")
    for name, reason in skipped.items():
        click.echo(f"{name}: cannot run here: {' '.join(reason.split())}", err=True)
    for name, error in failed.items():
        click.echo(f"{name}: {error}", err=True)
    built = len(tasks) - len(failed) - len(skipped)
    click.echo(f"{built} of {len(tasks)} images are there, {time.monotonic() - began:.1f} s")
    if failed or skipped:
        ctx.exit(1)
