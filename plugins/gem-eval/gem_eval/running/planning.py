"""What an evaluation plays: the rows of each task, and the plan of all episodes."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import gem_core as gem
from gem_core import EnvSpec, PlanItem
from gem_core.arguments import signature_of
from gem_core.cli import find_envs, parsed_choices, wrapper_stack
from gem_core.env import stable_hash
from gem_core.errors import ArgumentError
from gem_core.records import to_plain
from gem_core.registry import ToolSpec, load_entry_point, registry
from gem_eval.running.conditions import parse_condition

if TYPE_CHECKING:
    from gem_eval.suites import Model, Suite, SuiteTask


@dataclass(frozen=True)
class PlannedRow:
    """A row that is played.

    Args:
        name: Its identity, the same in every run of the suite: the task, and the row's ``task_id`` or the seed.
        seed: Seed of its episodes.
        index: Its number in the data set; None where the environment has no rows.
    """

    name: str
    seed: int
    index: int | None


@dataclass(frozen=True)
class PlannedTask:
    """A task with the rows that are played.

    Args:
        label: What scores call it.
        env_id: Id of the environment.
        kwargs: Its keyword arguments, wrappers included.
        rows: The rows, in the order in which they are played.
        total: Number of rows that there are; None where the environment has none.
        data_hash: SHA-256 of the rows that are played; None where the environment has none.
    """

    label: str
    env_id: str
    kwargs: dict[str, Any]
    rows: list[PlannedRow]
    total: int | None
    data_hash: str | None


@dataclass(frozen=True)
class Evaluation:
    """All that is played: each row of each task by each model, in an order that is always the same.

    Args:
        tasks: The tasks.
        epochs: How often each row is played by each model.
        items: The plan.
        row_of: Task and row of each item of the plan.
    """

    tasks: list[PlannedTask]
    epochs: int
    items: list[PlanItem]
    row_of: list[tuple[PlannedTask, PlannedRow]]

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.items) * self.epochs

    @property
    def envs(self) -> list[tuple[str, dict[str, Any]]]:
        """The environments, each with its keyword arguments."""
        distinct = {id(item.kwargs): (item.id or "", dict(item.kwargs or {})) for item in self.items}
        return list(distinct.values())


def plan_evaluation(suite: Suite, models: Sequence[Model]) -> Evaluation:
    """Return what an evaluation of a suite plays.

    Rows get their seeds from the suite's seed and their own identity, so that another task, limit or order leaves them
    the same. The models play a row beside each other.

    Args:
        suite: The suite.
        models: The models.

    Raises:
        ArgumentError: A task that cannot be played, or of which no row is left; or two tasks of one name; or a
            perturbation that does not fit a task.
        UnknownEnvError: There is no such environment.
    """
    given = suite.with_defaults()
    once = [task for place, task in enumerate(given) if task not in given[:place]]  # two suites may share a task
    tasks = [planned for task in once for planned in _planned(task, suite)]
    twice = [label for label, count in Counter(task.label for task in tasks).items() if count > 1]
    if twice:
        raise ArgumentError(
            f"two tasks are called {twice[0]!r} and differ: give one of them another name in the suite, or evaluate "
            "the suites apart"
        )
    items, row_of = [], []
    for task in tasks:
        kwargs = {model.perturb: _perturbed(task, model.perturb) for model in models}
        for row in task.rows:
            options = None if row.index is None else {"index": row.index}
            group = row.name if suite.epochs > 1 else None
            for model in models:
                items.append(
                    PlanItem(
                        task.env_id, row.seed, options, kwargs[model.perturb], group, suite.epochs, agent=model.label
                    )
                )
                row_of.append((task, row))
    return Evaluation(tasks, suite.epochs, items, row_of)


def _perturbed(task: PlannedTask, perturb: str) -> dict[str, Any]:
    """Return the keyword arguments of a task with perturbations: outside its tools, and inside any view.

    Raises:
        ArgumentError: They do not fit the task.
    """
    if not perturb:
        return task.kwargs
    wrappers = task.kwargs.get("wrappers", [])
    tools = [place for place, (name, _) in enumerate(wrappers) if name == "tools" or _is_tool(name)]
    behind = max(tools, default=-1) + 1
    more = [[name, options] for name, options in parsed_choices(perturb, "--perturb")]
    kwargs = {**task.kwargs, "wrappers": [*wrappers[:behind], *more, *wrappers[behind:]]}
    gem.make(task.env_id, **kwargs).close()
    return kwargs


def _is_tool(name: str) -> bool:
    return ":" not in name and isinstance(registry().wrapper(name), ToolSpec)


def _planned(task: SuiteTask, suite: Suite) -> list[PlannedTask]:
    """Return a task with its rows; of a glob, each task that it stands for."""
    envs = find_envs((task.id,), several=False)
    if len(envs) == 1:
        ((record, kwargs),) = envs
        return [_with_rows(task, task.label, record, {**kwargs, **task.kwargs}, suite)]
    if task.name is not None:
        raise ArgumentError(f"{task.id} stands for {len(envs)} environments, which cannot all be {task.name!r}")
    return [_with_rows(task, record.id, record, task.kwargs, suite) for record, _ in envs]


def _with_rows(task: SuiteTask, label: str, record: EnvSpec, kwargs: Mapping[str, Any], suite: Suite) -> PlannedTask:
    if record.seats:
        raise ArgumentError(
            f"{record.id} has several seats, {', '.join(record.seats)}: register one of them by "
            "gem_core.single_agent, or play it by 'gem run'"
        )
    kwargs = {**_roles(record, suite.roles), **kwargs}
    env: Any = gem.make(record.id, **kwargs)
    try:
        rows, total, data_hash = _rows_of(env.unwrapped, task, label, suite.seed)
    finally:
        env.close()
    if not rows:
        raise ArgumentError(f"{label}: none of {total} rows is left by --limit, --sample-ids and --where")
    stack = _stack(task)
    return PlannedTask(label, record.id, {**kwargs, "wrappers": stack} if stack else kwargs, rows, total, data_hash)


def _roles(record: EnvSpec, roles: Mapping[str, str]) -> dict[str, str]:
    """Return those roles that an environment has a keyword for."""
    if not roles:
        return {}
    signature = signature_of(load_entry_point(record.entry_point, f"environment {record.id!r}"))
    known = () if signature is None else signature.parameters
    return {role: agent for role, agent in roles.items() if role in known}


def _rows_of(env: Any, task: SuiteTask, label: str, seed: int) -> tuple[list[PlannedRow], int | None, str | None]:
    """Return the rows that a task chooses, how many there are, and the hash of those chosen."""
    total: int | None = env.num_tasks
    if total is None:
        _refuse_choice(task, label)
        seeds = [stable_hash(seed, "row", label, number) for number in range(task.limit or task.episodes)]
        return [PlannedRow(f"{label}/seed {each}", each, None) for each in seeds], None, None
    chosen = _chosen(env, task, total)
    names, content = [], hashlib.sha256()
    for index in chosen:
        facts = dict(env.task_row(index))
        names.append(str(facts.get("task_id", index)))
        content.update(_json(to_plain(facts)))
    counts = Counter(names)
    # A task_id that several rows share does not tell them apart.
    names = [name if counts[name] == 1 else f"{name} #{index}" for name, index in zip(names, chosen, strict=True)]
    rows = [
        PlannedRow(f"{label}/{name}", stable_hash(seed, "row", label, name), index)
        for name, index in zip(names, chosen, strict=True)
    ]
    return rows, total, content.hexdigest()


def _chosen(env: Any, task: SuiteTask, total: int) -> list[int]:
    """Return the indices of the rows that a task chooses, in the order in which they are played."""
    chosen = list(range(total))
    if task.sample_ids is not None:
        by_id: dict[str, list[int]] = {}
        for index in chosen:
            by_id.setdefault(str(env.task_row(index).get("task_id", index)), []).append(index)
        missing = [each for each in task.sample_ids if each not in by_id]
        if missing:
            raise ArgumentError(
                f"{task.label}: no row has the task_id {missing[0]!r}; the first is {next(iter(by_id), None)!r}"
            )
        chosen = [index for each in dict.fromkeys(task.sample_ids) for index in by_id[each]]
    if task.where is not None:
        holds = parse_condition(task.where)
        chosen = [index for index in chosen if holds(env.task_row(index))]
    if task.shuffle is not None:
        chosen = [chosen[place] for place in np.random.default_rng(task.shuffle).permutation(len(chosen))]
    return chosen[: task.limit]


def _refuse_choice(task: SuiteTask, label: str) -> None:
    for name, given in (("sample_ids", task.sample_ids), ("where", task.where)):
        if given is not None:
            raise ArgumentError(f"{label} has no rows to choose from, so {name} has no meaning there; use limit")


def _stack(task: SuiteTask) -> list[Any]:
    """Return the tools and wrappers of a task as ``make`` takes them."""
    tools, wrappers = (
        tuple(json.dumps([[name, options]]) for name, options in choices) for choices in (task.tools, task.wrappers)
    )
    stack: list[Any] = wrapper_stack(wrappers, tools, task.max_tool_uses, task.max_turns)
    return [[name, dict(options)] for name, options in stack]


def digest(content: Any) -> str:
    """Return the SHA-256 of plain JSON."""
    return hashlib.sha256(_json(content)).hexdigest()


def _json(content: Any) -> bytes:
    return json.dumps(content, sort_keys=True, ensure_ascii=True).encode("ascii")
