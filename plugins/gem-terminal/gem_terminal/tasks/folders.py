"""Finding tasks: one folder, a folder of tasks, or a list of them."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from gem_terminal.errors import TaskError
from gem_terminal.tasks import harbor, terminal_bench
from gem_terminal.tasks.reading import TaskFolder

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Task

_EXPECTED = "expected a task folder, or a folder of tasks"
_FILES = f"{harbor.FILE} (Harbor) or {terminal_bench.FILE} (Terminal-Bench)"
_INSTALLS = re.compile(
    r"^[^#\n]*?\b(?P<what>apt(?:-get)?\s++(?:-\S++\s++){0,5}(?:update|install)|apk\s++add|dnf\s++install|"
    r"pip3?\s++install|uvx|uv\s++(?:run|add|sync|tool|pip|init)|npm\s++(?:install|ci)|npx|git\s++clone\s++https?|"
    r"(?:curl|wget)\b[^\n]{0,200}?https?://(?!localhost|127\.|\[::1\]|0\.0\.0\.0))[^\n]*+",
    re.MULTILINE,
)
_OFFLINE = ("--no-index", "--offline", "--find-links")


class BrokenTask(NamedTuple):
    """A task folder that cannot be read, and why."""

    name: str
    folder: Path
    error: TaskError


class TaskSet(NamedTuple):
    """Tasks in a fixed order, whose names differ, and folders that could not be read."""

    tasks: tuple[Task, ...]
    broken: tuple[BrokenTask, ...] = ()


def find_tasks(paths: Iterable[str | os.PathLike[str]], *, variables: Mapping[str, str] | None = None) -> TaskSet:
    """Read the tasks of folders.

    A path is a task folder, or a folder of them, or has such a folder in it, as ``tasks/NAME``; hidden folders and
    links are passed over. The order is that of the list, and of names within a folder. A folder that is there twice
    counts once. Among several, one that cannot be read is kept in ``TaskSet.broken``.

    Args:
        paths: The folders.
        variables: Values for variables that tasks name; the environment of this process is never read.

    Raises:
        TaskError: A path is missing or has no tasks; no task can be read; or the only one cannot.
    """
    listed = list(paths)
    if not listed:
        raise TaskError(f"no path of a task is given; {_EXPECTED}, or a list of them.")
    found: dict[Path, Path] = {}  # folders of tasks by themselves, each with the folder of its set
    for root in map(_folder, listed):
        for folder in _task_folders(root):
            found.setdefault(folder, root)
    tasks, broken = [], []
    for folder, name in _names(found).items():
        try:
            tasks.append(_read(folder, name, variables or {}))
        except TaskError as error:
            broken.append(BrokenTask(name, folder, error))
    if not tasks:
        more = f" None of the {len(broken)} tasks can be read; this is the first." if len(broken) > 1 else ""
        raise TaskError(f"{broken[0].error}{more}") from broken[0].error
    return TaskSet(tuple(tasks), tuple(broken))


def _folder(path: str | os.PathLike[str]) -> Path:
    try:
        folder = Path(path).expanduser()
        if folder.is_dir():
            return folder.resolve()
        what = "is a file" if folder.exists() else "there is no such folder"
    except (OSError, ValueError, RuntimeError, TypeError) as error:
        raise TaskError(f"{str(path)[:200]!r} is no path of a task folder: {error}.") from error
    raise TaskError(f"{folder}: {what}; {_EXPECTED}.")


def _is_task(folder: Path) -> bool:
    return any(os.path.lexists(folder / file) for file in (harbor.FILE, terminal_bench.FILE))


def _task_folders(root: Path) -> list[Path]:
    """Return a folder itself, or the task folders in it, or those one level down, sorted by name."""
    if _is_task(root):
        return [root]
    found: list[Path] = []
    for child in _children(root):
        found += [child] if _is_task(child) else filter(_is_task, _children(child))
    if not found:
        raise TaskError(f"{root}: has no task; expected a folder with {_FILES}, or a folder of such folders.")
    return found


def _children(folder: Path) -> list[Path]:
    """Return the folders in a folder, without hidden ones and links."""
    try:
        return sorted(
            each
            for each in folder.iterdir()
            if each.is_dir() and not each.is_symlink() and not each.name.startswith(".")
        )
    except OSError as error:
        raise TaskError(f"{folder}: cannot be read: {error.strerror}.") from error


def _names(found: Mapping[Path, Path]) -> dict[Path, str]:
    """Return a name for each folder: its own; where that is taken, the path below its set's, or below ever more."""
    names = {folder: folder.name or "task" for folder in found}
    for attempt in range(3):
        taken = Counter(names.values())
        for folder, root in found.items():
            if taken[names[folder]] > 1:
                base = (root, root.parent, Path(folder.anchor))[attempt]
                names[folder] = folder.relative_to(base).as_posix() if folder != base else folder.name
    return names


def _read(path: Path, name: str, variables: Mapping[str, str]) -> Task:
    folder = TaskFolder(path, variables)
    if folder.has_file(harbor.FILE) and folder.has_file(terminal_bench.FILE):
        folder.note(f"{terminal_bench.FILE}: has no effect beside {harbor.FILE}.")
    read = harbor.read_harbor if folder.has_file(harbor.FILE) else terminal_bench.read_terminal_bench
    missing = folder.variables.missing
    try:
        task = read(folder, name)
    except TaskError as error:
        names = ", ".join(missing)[:200]
        hint = f" Variables without a value: {names}; give them with variables=." if missing else ""
        raise TaskError(f"{error}{hint}") from error
    _note_network_needs(folder, task)
    lacking = [f"{where}: a value of the variable {key!r}, which variables= gives" for key, where in missing.items()]
    environment = replace(task.environment, unsupported=tuple(dict.fromkeys([*folder.refused, *lacking])))
    notes, asked = tuple(folder.notes), folder.variables.asked
    return replace(task, environment=environment, notes=notes, variables=asked, missing=missing)


def _note_network_needs(folder: TaskFolder, task: Task) -> None:
    """Note tests that install programs without a network: such scripts often reward 0 what they could not test."""
    for verifier in (step.verifier for step in task.steps):
        network = verifier.network or (verifier.environment or task.environment).network or "none"
        above, _, name = verifier.command[-1].rpartition("/")
        script = verifier.files.get(verifier.command[-1]) or verifier.files.get(above, task.folder / "none") / name
        if network != "none" or not script.is_file():
            continue
        with script.open("rb") as file:
            text = file.read(200_000).decode("utf-8", "replace")
        installs = [found for found in _INSTALLS.finditer(text) if not any(word in found[0] for word in _OFFLINE)]
        if installs:
            what = " ".join(installs[0]["what"].split())[:60]
            folder.note(
                f"{script.relative_to(task.folder).as_posix()}: needs a network for {what!r}, it seems, and the task "
                "asks for none: network='public' gives it one, the agent included."
            )
