"""What the subcommands share: which tasks are meant, and what their machines may take."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from gem_core.registry import registry
from gem_terminal.backends.docker.backend import shared_backend
from gem_terminal.backends.interface import Limits
from gem_terminal.errors import MachineError, TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend
    from gem_terminal.tasks.task import Task

F = TypeVar("F", bound=Callable[..., Any])

_SAMPLE = "terminal:Sample"


def shared_options(function: F) -> F:
    """Add the argument for tasks, and the options for their variables, images and machines, as ``TerminalEnv`` has."""
    cpus = "Processors of a machine. What is not said of these is what the task asks for."
    options = (
        click.argument("where", nargs=-1, type=click.Path(), metavar="[PATH|ID]..."),
        click.option(
            "--variable",
            "variables",
            multiple=True,
            metavar="NAME[=VALUE]",
            help="Environment variable for the tasks; without a value, that of this process. Can be repeated.",
        ),
        click.option(
            "--build-arg",
            "build_args",
            multiple=True,
            metavar="NAME=VALUE",
            help="Argument for the build of images. Can be repeated.",
        ),
        click.option("--cpus", type=click.FloatRange(0.01), help=cpus),
        click.option("--memory-mb", type=click.IntRange(16), help="Megabytes of memory of a machine."),
        click.option("--processes", type=click.IntRange(16), help="Processes and threads of a machine at once."),
        click.option("--storage-mb", type=click.IntRange(1), help="Megabytes that a machine may write."),
    )
    for option in reversed(options):
        function = option(function)
    return function


def chosen_limits(network: str = "task", **most: Any) -> Limits:
    """Return the limits that the options name."""
    return Limits(network=network, **{name: value for name, value in most.items() if value is not None})


def chosen_backend(build_args: tuple[str, ...]) -> Backend:
    """Return the backend, which builds images with these arguments.

    Raises:
        EngineError: No engine answers.
    """
    pairs = [argument.partition("=") for argument in build_args]
    for name, equals, _ in pairs:
        if not equals or not name:
            raise click.UsageError(f"--build-arg takes NAME=VALUE, not {name!r}")
    return shared_backend({name: value for name, _, value in pairs})


def paths_of(where: tuple[str, ...]) -> list[str | Path]:
    """Return the paths of tasks, given as paths or as ids of environments such as ``terminal:Sample``."""
    return [path for each in where or (_SAMPLE,) for path in _paths_of(each)]


def why_not(backend: Backend, task: Task) -> str:
    """Return why a task cannot run on a backend; empty where it can."""
    try:
        backend.check(task)
    except (TaskError, MachineError) as error:
        return str(error)
    return ""


def _paths_of(where: str) -> list[str | Path]:
    if Path(where).exists() or ":" not in where:
        return [where]
    if where not in {record.id for record in registry().envs()} and not where.startswith("terminal:"):
        return [where]  # a folder that a package ships
    path = registry().env(where).kwargs.get("path")
    if path is None:
        raise click.UsageError(f"{where} has no tasks of its own: give the path of a folder")
    return list(path) if isinstance(path, list | tuple) else [path]
