"""Reads the data folder of a benchmark: the database, the policy, the tools' descriptions and the tasks."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from gem_core.errors import DatasetError
from gem_tau.database import Database, Digest
from gem_tau.domains import SAMPLE, TAU2_AIRLINE, TAU2_RETAIL, TAU_RETAIL, Domain
from gem_tau.records import Airline, Order, Product, Shop, TauUser
from gem_tau.tasks import Task, Tau2Task, TauTask, read_python_tasks, read_python_tool

T = TypeVar("T")

_EXPECTED = (
    "a folder of tau-bench's retail has orders.json, products.json, users.json, policy.md and tasks_test.json, "
    "one of tau2-bench's retail or airline db.json, tasks.json and policy.md"
)
_IN_CHECKOUT = Path("tau_bench", "envs", "retail")
_TAU_TABLES: dict[str, type[Any]] = {
    "orders": dict[str, Order],
    "products": dict[str, Product],
    "users": dict[str, TauUser],
}


class Function(BaseModel):
    """A function, as chat servers describe it."""

    name: str
    description: str = ""
    parameters: dict[str, Any] = Field(default_factory=dict)


class ToolSchema(BaseModel):
    """A tool in ``tools.json``."""

    function: Function


@dataclass(frozen=True)
class TaskSet:
    """What a data folder holds."""

    domain: Domain
    """The tools, which are functions of a database."""

    database: Database
    """The database before any task, which must not be changed: each episode works on a ``fork`` of it."""

    policy: str
    """What the assistant is told."""

    tools: list[dict[str, Any]]
    """Descriptions of the tools, as chat servers take them."""

    tools_from: str
    """Where these are from: a file of the folder, or ``gem-tau`` where it has none."""

    tasks: tuple[Task, ...]
    """The tasks whose reward can be computed, in the file's order."""

    left_out: dict[str, str] = field(default_factory=dict)
    """Id of each other task, and why its reward cannot be computed."""

    digest: Digest = field(init=False, repr=False)
    """Computes the hash of a database."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "digest", Digest(self.database, "json" if self.domain.tau2 else "tuples"))


def read_folder(folder: str | Path, split: str | None = None) -> TaskSet:
    """Read a data folder.

    Args:
        folder: The folder, in the form of tau-bench's retail domain, or tau2-bench's retail or airline. A checkout of
            tau-bench's repository will do: its Python files of tasks and tools are read, never run. ``gem_tau:sample``
            is the shop that comes with this plugin.
        split: Only the tasks of this split, such as ``test``; without it, all that the folder has.

    Raises:
        DatasetError: The folder or a file in it is missing or malformed, or it has no such split.
    """
    if folder == "gem_tau:sample":
        return _read_sample(split)
    path = Path(folder)
    if not path.is_dir():
        raise DatasetError(f"there is no folder {path}; {_EXPECTED}")
    if (path / "db.json").is_file():
        return _read_tau2(path, split)
    if (path / _IN_CHECKOUT).is_dir():
        path /= _IN_CHECKOUT
    if (path / "orders.json").is_file() or (path / "data" / "orders.json").is_file():
        return _read_tau(path, split)
    raise DatasetError(f"{path} has neither orders.json nor db.json; {_EXPECTED}")


def _read_sample(split: str | None) -> TaskSet:
    path = Path(__file__).parent / "data" / "sample"
    _check_split(path, split, [])
    tasks = _read_checked(list[TauTask], path / "tasks.json")
    return TaskSet(
        domain=SAMPLE,
        database=_json(path / "database.json"),
        policy=_text(path / "policy.md"),
        tools=SAMPLE.schemas(),
        tools_from="gem-tau",
        tasks=tuple(each.task(f"sample-{number}") for number, each in enumerate(tasks)),
    )


def _read_tau(path: Path, split: str | None) -> TaskSet:
    data = path if (path / "orders.json").is_file() else path / "data"
    files = {file.stem.removeprefix("tasks_"): file for form in ("py", "json") for file in path.glob(f"tasks_*.{form}")}
    if not files:
        raise DatasetError(f"{path} has no tasks_test.json, tasks_train.json or tasks_dev.json")
    _check_split(path, split, sorted(files))
    database = {name: _json(data / f"{name}.json") for name in _TAU_TABLES}
    for name, form in _TAU_TABLES.items():
        _checked(form, database[name], data / f"{name}.json")
    tasks = [
        each.task(f"{name}-{number}")
        for name in ([split] if split else sorted(files))
        for number, each in enumerate(_checked(list[TauTask], _tasks(files[name]), files[name]))
    ]
    wiki = path / "wiki.md"
    tools, tools_from = _tools(path)
    return TaskSet(
        domain=TAU_RETAIL,
        database=database,
        policy=_text(wiki if wiki.is_file() else path / "policy.md"),
        tools=tools,
        tools_from=tools_from,
        tasks=tuple(tasks),
    )


def _tools(path: Path) -> tuple[list[dict[str, Any]], str]:
    """Return the tools' descriptions, and where they are from; the Python files of a checkout are read, never run."""
    tools: list[dict[str, Any]]
    if (path / "tools.json").is_file():
        tools = _json(path / "tools.json")
        _checked(list[ToolSchema], tools, path / "tools.json")
        return tools, "tools.json"
    files = {name: path / "tools" / f"{name}.py" for name in TAU_RETAIL.tools}
    if not (path / "tools").is_dir():
        return TAU_RETAIL.schemas(), "gem-tau"
    tools = [_python(read_python_tool, file, "get_info() with a literal") for file in files.values()]
    for schema, file in zip(tools, files.values(), strict=True):
        _checked(ToolSchema, schema, file)
    return tools, "tools/*.py"


def _tasks(path: Path) -> Any:
    if path.suffix == ".json":
        return _json(path)
    return _python(read_python_tasks, path, "a list of Task(...)")


def _python(read: Callable[[str], T], path: Path, expected: str) -> T:
    text = _text(path)
    try:
        return read(text)
    except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError) as error:
        raise DatasetError(f"{path} has other code than {expected}: {error}") from error


def _read_tau2(path: Path, split: str | None) -> TaskSet:
    raw = _json(path / "db.json")
    domain, form = (TAU2_AIRLINE, Airline) if isinstance(raw, dict) and "flights" in raw else (TAU2_RETAIL, Shop)
    tasks = _read_checked(list[Tau2Task], path / "tasks.json")
    splits_file = path / "split_tasks.json"
    if split is not None:
        splits = _read_checked(dict[str, list[str]], splits_file) if splits_file.is_file() else {}
        _check_split(path, split, splits)
        tasks = [task for task in tasks if task.id in splits[split]]
    return TaskSet(
        domain=domain,
        database=_checked(form, raw, path / "db.json").model_dump(),
        policy=_text(path / "policy.md"),
        tools=domain.schemas(),
        tools_from="gem-tau",
        tasks=tuple(task.task() for task in tasks if not task.left_out()),
        left_out={task.id: reason for task in tasks if (reason := task.left_out())},
    )


def _check_split(path: Path, split: str | None, names: Iterable[str]) -> None:
    if split is not None and split not in names:
        raise DatasetError(f"{path} has no split {split!r}; it has: {', '.join(names) or 'none'}")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise DatasetError(f"{path} is missing; {_EXPECTED}") from error
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path} cannot be read: {error}") from error


def _json(path: Path) -> Any:
    text = _text(path)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{path} is not JSON: {error}") from error


def _checked(form: type[T], value: Any, path: Path) -> T:
    try:
        return TypeAdapter(form).validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise DatasetError(f"{path}: {where + ': ' if where else ''}{first['msg']}") from error


def _read_checked(form: type[T], path: Path) -> T:
    return _checked(form, _json(path), path)
