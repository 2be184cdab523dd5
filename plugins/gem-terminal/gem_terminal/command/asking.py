"""What the subcommands share: which tasks are meant, and on which backend."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from gem_core.registry import registry
from gem_terminal.backends.choosing import NAMES, shared_backend
from gem_terminal.backends.interface import Limits
from gem_terminal.errors import MachineError, TaskError
from gem_terminal.selecting import read_tasks, select_tasks

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend
    from gem_terminal.tasks.folders import TaskSet
    from gem_terminal.tasks.task import Task

F = TypeVar("F", bound=Callable[..., Any])

SAMPLE = "terminal:Sample"


def backend_options(function: F) -> F:
    """Add the options that choose a backend."""
    function = click.option(
        "--build-arg",
        "build_args",
        multiple=True,
        metavar="NAME=VALUE",
        help="Argument for the build of images. Can be repeated.",
    )(function)
    return click.option("--backend", type=click.Choice(NAMES), default="auto", show_default=True)(function)


def limit_options(function: F) -> F:
    """Add the options for what each machine may take, as ``TerminalEnv`` has them."""
    least = {"storage-mb": 1, "processes": 16, "memory-mb": 16}
    for name, words in (
        ("storage-mb", "Megabytes that a machine may write."),
        ("processes", "Processes and threads of a machine at once."),
        ("memory-mb", "Megabytes of memory of a machine."),
    ):
        function = click.option(f"--{name}", type=click.IntRange(least[name]), help=words)(function)
    words = "Processors of a machine. What is not said of these is what the task asks for."
    return click.option("--cpus", type=click.FloatRange(0.01), help=words)(function)


def chosen_limits(network: str = "task", **most: Any) -> Limits:
    """Return the limits that the options name."""
    return Limits(network=network, **{name: value for name, value in most.items() if value is not None})


network_option = click.option(
    "--network",
    type=click.Choice(["task", "none", "public"]),
    default="task",
    show_default=True,
    help="Network of the machine; 'task' is what the task asks for.",
)
"""Adds the option that overrules a task's network."""


variable_option = click.option(
    "--variable",
    "variables",
    multiple=True,
    metavar="NAME[=VALUE]",
    help="Environment variable for the tasks; without a value, that of this process. Can be repeated.",
)
"""Adds the option for the variables that tasks take from their host."""


def chosen_backend(name: str, build_args: tuple[str, ...]) -> Backend:
    """Return the backend that the options name."""
    pairs = [argument.partition("=") for argument in build_args]
    for name_of, equals, _ in pairs:
        if not equals or not name_of:
            raise click.UsageError(f"--build-arg takes NAME=VALUE, not {name_of!r}")
    return shared_backend(name, {name_of: value for name_of, _, value in pairs})


def tasks_at(where: tuple[str, ...], variables: tuple[str, ...] = ()) -> TaskSet:
    """Return the tasks at paths, or of ids of environments such as ``terminal:Sample``."""
    return read_tasks(_paths(where), variables)


def some_tasks(where: tuple[str, ...], names: tuple[str, ...], variables: tuple[str, ...] = ()) -> list[Task]:
    """Return the tasks at paths or ids that have one of the names, or match one of the patterns; all without any."""
    return select_tasks(_paths(where), list(names) or None, variables)


def one_task(name: str, where: str | None, variables: tuple[str, ...] = ()) -> Task:
    """Return the task of a folder, or of a name at a path or id."""
    if where is None and Path(name).is_dir():
        found = select_tasks(name, None, variables)
        if len(found) > 1:
            raise TaskError(f"there are {len(found)} tasks in {name}; name the folder of one of them")
        return found[0]
    return read_tasks(_paths((where or SAMPLE,)), variables)[name]


def why_not(backend: Backend | None, task: Task) -> str:
    """Return why a task cannot run on a backend; empty where it can."""
    if backend is None:
        return ""
    try:
        backend.check(task)
    except (TaskError, MachineError) as error:
        return str(error)
    return ""


def _paths(where: tuple[str, ...]) -> list[str | Path]:
    return [path for each in where or (SAMPLE,) for path in _paths_of(each)]


def _paths_of(where: str) -> list[str | Path]:
    if Path(where).exists() or ":" not in where:
        return [where]
    if where not in {record.id for record in registry().envs()} and not where.startswith("terminal:"):
        return [where]  # a folder that a package ships
    path = registry().env(where).kwargs.get("path")
    if path is None:
        raise click.UsageError(f"{where} has no tasks of its own: give the path of a folder")
    return list(path) if isinstance(path, list | tuple) else [path]
