"""Reading MCPMark's task folders: ``description.md``, ``meta.json``, ``verify.py``, ``prepare_environment.py``."""

from __future__ import annotations

import fnmatch
import functools
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean
from gem_mcpmark.errors import TaskError

DESCRIPTION, META, VERIFY, PREPARE = "description.md", "meta.json", "verify.py", "prepare_environment.py"

_SAMPLE = "gem_mcpmark:sample"
_DUMPS = "postgres_state"
"""Name of the folder beside ``tasks`` in which MCPMark's own instructions have the dumps."""

_ENDINGS = (".backup", ".dump", ".tar", ".sql", ".sql.gz")
_MAKES_ROLES = re.compile(
    r"\b(?:create|alter|drop)[\s*`]+(?:(?:an?|the|new|database)[\s*`]+){0,4}(?:role|user|group)s?\b", re.IGNORECASE
)
_WORD = re.compile(r"\w+")


@dataclass(frozen=True)
class Task:
    """One task folder.

    Args:
        name: ``"category/task"``, by the names of the folders.
        folder: Where it is.
        category: Which database it works on.
        description: What the agent is asked.
        difficulty: As ``meta.json`` says it, such as ``"L2"``; None where it does not.
    """

    name: str
    folder: Path
    category: str
    description: str
    difficulty: str | None = None

    @property
    def verify(self) -> Path:
        """The script that tells whether the task is solved."""
        return self.folder / VERIFY

    @property
    def prepare(self) -> Path | None:
        """The script that fills an empty database; None where there is none."""
        script = self.folder / PREPARE
        return script if script.is_file() else None

    @functools.cached_property
    def agent_makes_roles(self) -> bool:
        """Whether the agent is asked to make roles, which belong to the whole server."""
        return bool(_MAKES_ROLES.search(self.description))

    @functools.cached_property
    def verify_makes_roles(self) -> bool:
        """Whether ``verify.py`` makes roles."""
        return bool(_MAKES_ROLES.search(_text(self.verify)))

    @functools.cached_property
    def prepare_makes_roles(self) -> bool:
        """Whether ``prepare_environment.py`` makes roles."""
        return self.prepare is not None and bool(_MAKES_ROLES.search(_text(self.prepare)))

    @property
    def makes_roles(self) -> bool:
        """Whether anybody makes roles in this task."""
        return self.agent_makes_roles or self.verify_makes_roles or self.prepare_makes_roles

    @functools.cached_property
    def words(self) -> frozenset[str]:
        """All words of its files, in lower case: the names of roles that it makes are among them."""
        scripts = [self.verify, *([self.prepare] if self.prepare else [])]
        texts = [self.description, *map(_text, scripts)]
        return frozenset(word.lower() for text in texts for word in _WORD.findall(text))


def read_tasks(path: str | Path, names: str | Sequence[str] | None = None) -> list[Task]:
    """Return the tasks in a folder, sorted by name.

    Args:
        path: A task's folder, or one that holds task folders at any depth, such as ``tasks/postgres/easy``;
            ``"gem_mcpmark:sample"`` are the plugin's own.
        names: Names, or patterns such as ``"chinook/*"``; None for all.

    Raises:
        TaskError: There is no task, or one cannot be read.
        ArgumentError: A name that no task has.
    """
    root = located(path)
    if not root.is_dir():
        raise TaskError(f"{root}: there is no such folder; expected a folder of MCPMark's PostgreSQL tasks")
    folders = [script.parent for script in sorted(root.rglob(VERIFY)) if (script.parent / DESCRIPTION).is_file()]
    tasks = [task for task in map(_read, folders) if task is not None]
    if not tasks:
        raise TaskError(
            f"{root}: has no PostgreSQL task; expected folders with {DESCRIPTION} and {VERIFY}, as MCPMark's "
            "tasks/postgres/easy"
        )
    seen: dict[str, Task] = {}
    for task in tasks:
        if task.name in seen:
            both = f"{seen[task.name].folder} and {task.folder}"
            raise TaskError(f"two tasks are called {task.name!r}: {both}; give the folder of one of them")
        seen[task.name] = task
    return _chosen(sorted(tasks, key=lambda task: task.name), names)


def located(path: str | Path) -> Path:
    """Return the folder that a path names, which may be that of the sample."""
    return Path(__file__).parent / "sample" if path == _SAMPLE else Path(path).expanduser().resolve()


def find_dump(task: Task, databases: str | Path | None) -> Path | None:
    """Return the dump of a task's database.

    Args:
        task: Its category is the dump's name, as in ``chinook.backup`` or ``chinook.sql``.
        databases: The folder of the dumps; None for the folder ``postgres_state`` beside or above the tasks.

    Raises:
        TaskError: ``databases`` is no folder.
    """
    if databases is not None:
        folders = [located(databases)]
        if not folders[0].is_dir():
            raise TaskError(f"databases: {folders[0]} is no folder; expected one with files such as chinook.backup")
    else:
        folders = [above / _DUMPS for above in task.folder.parents]
    candidates = [folder / f"{task.category}{ending}" for folder in folders for ending in _ENDINGS]
    return next((path for path in candidates if path.is_file()), None)


def _read(folder: Path) -> Task | None:
    """Return the task of a folder; None for one of another service than PostgreSQL."""
    category, difficulty = folder.parent.name, None
    meta = folder / META
    if meta.is_file():
        try:
            said = json.loads(meta.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise TaskError(f"{meta}: cannot be read as JSON: {error}") from error
        if not isinstance(said, dict):
            raise TaskError(f"{meta}: must hold an object, not {type(said).__name__}")
        if "postgres" not in said.get("mcp", ["postgres"]):
            return None
        category, difficulty = str(said.get("category_id", category)), said.get("difficulty")
    try:
        description = (folder / DESCRIPTION).read_text(encoding="utf-8").strip()
    except (OSError, ValueError) as error:
        raise TaskError(f"{folder / DESCRIPTION}: cannot be read: {error}") from error
    return Task(f"{folder.parent.name}/{folder.name}", folder, category, description, difficulty)


def _chosen(tasks: list[Task], names: str | Sequence[str] | None) -> list[Task]:
    if names is None:
        return tasks
    wanted, known = [names] if isinstance(names, str) else list(names), [task.name for task in tasks]
    for pattern in wanted:
        if not fnmatch.filter(known, pattern):
            hint = did_you_mean(pattern, known)
            raise ArgumentError(f"tasks: there is none called {pattern!r} among {len(known)}.{hint}")
    return [task for task in tasks if any(fnmatch.fnmatchcase(task.name, pattern) for pattern in wanted)]


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")
