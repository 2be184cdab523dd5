"""Which tasks an environment has: where they are, which of them were asked for, and the variables they are given."""

from __future__ import annotations

import fnmatch
import importlib.util
import logging
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean
from gem_terminal.errors import TaskError
from gem_terminal.sample import sample_folder
from gem_terminal.tasks.folders import TaskSet, find_tasks

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task

logger = logging.getLogger(__name__)

_SAMPLE = "gem_terminal:sample/"
_SHIPPED = re.compile(r"(?P<package>[A-Za-z_]\w*):(?P<inside>[\w-][\w./-]*)", re.ASCII)

Paths = str | Path | Sequence[str | Path]
GivenVariables = Mapping[str, object] | Sequence[str] | None
"""Values by name, or a list of ``"NAME=value"`` and of ``"NAME"``, whose value is that in the host's environment."""


def read_tasks(path: Paths, variables: GivenVariables = None) -> TaskSet:
    """Return all tasks at a path, or several, those that cannot be read included; see ``find_tasks``.

    A path is a task's folder, or one of several; ``"package:folder"`` is in an installed package.

    Raises:
        ArgumentError: A variable that cannot be one, or that no task asks for.
        TaskError: There is nothing, or a single task that cannot be read.
    """
    several = [path] if isinstance(path, str | Path) else list(path)
    given = _given(variables)
    found = find_tasks([_located(each) for each in several], variables=given)
    asked = {name for task in found.tasks for name in task.variables}
    for name in given:
        if name not in asked and not found.broken:
            there = f"They ask for {', '.join(sorted(asked))[:500]}" if asked else "They ask for none"
            raise ArgumentError(f"variables: no task asks for {name!r}.{did_you_mean(name, asked)} {there}")
    return found


def select_tasks(
    path: Paths | None, names: str | Sequence[str] | None = None, variables: GivenVariables = None
) -> list[Task]:
    """Return the tasks that were asked for, in order.

    Args:
        path: As for ``read_tasks``.
        names: Names, or patterns such as ``"git-*"``; None for all.
        variables: As for ``read_tasks``.

    Raises:
        ArgumentError: No path, a name that no task has, or a variable that a task needs and is not given.
    """
    if path is None:
        raise ArgumentError("give path: a task's folder, a folder of tasks, or a list of them")
    found = read_tasks(path, variables)
    for broken in found.broken:
        logger.warning("gem-terminal: the task %s is left out: %s", broken.name, broken.error)
    tasks = list(found.tasks)
    if names is not None:
        wanted, known = [names] if isinstance(names, str) else list(names), [task.name for task in tasks]
        for pattern in wanted:
            if not fnmatch.filter(known, pattern):
                hint = did_you_mean(pattern, known)
                raise ArgumentError(f"there is no task {pattern!r} among {len(known)}.{hint} See 'gem terminal list'")
        tasks = [task for task in tasks if any(fnmatch.fnmatchcase(task.name, pattern) for pattern in wanted)]
    if why := _why_missing(tasks):
        raise ArgumentError(why)
    return tasks


def _why_missing(tasks: Sequence[Task]) -> str:
    """Return which variables tasks need and are not given, and how to give them; empty where there are none."""
    missing = {name: where for task in tasks for name, where in task.missing.items()}
    lacking = [task.name for task in tasks if task.missing]
    if not missing:
        return ""
    who = f"the task {lacking[0]!r} needs" if len(lacking) == 1 else f"{len(lacking)} of {len(tasks)} tasks need"
    what = ", ".join(f"{name!r} ({where})" for name, where in missing.items())
    name = next(iter(missing))
    return (
        f"{who} variables that have no value: {what[:1000]}. Give values with variables={{{name!r}: '…'}}, or with "
        f"variables=[{name!r}] that of this process's environment; on the command line with --variable {name}=… "
        f"(gem terminal) or --set 'variables=[\"{name}\"]' (gem run)"
    )


def _given(variables: GivenVariables) -> dict[str, str]:
    """Return variables by name. The environment of this process is asked only for names that were listed."""
    if variables is None or isinstance(variables, Mapping):
        pairs = dict(variables or {})
    else:
        parted = [each.partition("=") for each in ([variables] if isinstance(variables, str) else variables)]
        pairs = {name: value if equals else os.environ.get(name) for name, equals, value in parted}
    for name, value in pairs.items():
        if value is None:
            raise ArgumentError(f"variables: {name!r} is not in the environment; give its value as NAME=value")
        if not name or not isinstance(value, str | int | float) or "\0" in f"{name}{value}":
            raise ArgumentError(f"variables: {name!r} is {value!r:.60}; expected a name and its value, a text")
    return {name: str(value) for name, value in pairs.items()}


def _located(path: str | Path) -> Path:
    if isinstance(path, str) and path.startswith(_SAMPLE):
        form, _, inside = path.removeprefix(_SAMPLE).partition("/")
        return sample_folder(form) / inside
    shipped = _SHIPPED.fullmatch(path) if isinstance(path, str) and not Path(path).exists() else None
    if shipped is None:
        return Path(path)
    found = importlib.util.find_spec(shipped["package"])
    places = found.submodule_search_locations if found else None
    if not places:
        raise TaskError(f"there is no package {shipped['package']!r}, so that {path} is nowhere")
    return Path(next(iter(places))) / shipped["inside"]
