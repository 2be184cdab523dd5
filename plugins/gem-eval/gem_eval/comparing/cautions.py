"""Why two runs may not be comparable: they differ in more than who acted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from gem_core import Episode
from gem_core.cli import counted
from gem_core.errors import EpisodeFileError
from gem_core.records import to_plain
from gem_eval.grouping import grouped
from gem_eval.settings import asked_differently, asked_of, code_in, differing, short

if TYPE_CHECKING:
    from gem_eval.comparing.sides import Side, Task

_STARTS = {"kwargs": "arguments", "wrappers": "wrappers", "tools": "tools", "system": "system prompt"}


def cautions_of(a: Side, b: Side, paired: Sequence[Task]) -> list[str]:
    """Return in words what two sides differ in besides their models.

    Compared are, where there is a ``run.json``, arguments, code and hash of the data of the tasks that both have, the
    limits, the roles of models and how the models were sampled; and of the records the seeds of all rows and, of one
    row of each task, versions, arguments, wrappers, tools, system prompt and the first observation.

    Args:
        a: The first side.
        b: The second.
        paired: The rows that both have.
    """
    runs = [a.run] if a.run is b.run else [a.run, b.run]
    found = [f"{counted(run.damaged, 'line')} of {run.path} cannot be read, left out" for run in runs if run.damaged]
    if all(run.info for run in runs):
        found += _of_settings(a, b)
    told = a.run is b.run or (a.run.is_folder and b.run.is_folder)
    return found + _of_seeds(a, b, paired) + list(_of_records(a, b, paired, told=told))


def _of_settings(a: Side, b: Side) -> Iterator[str]:
    """Compare what ``run.json`` of both says that scores depend on besides the model."""
    one, other = (asked_of(side.run.info) for side in (a, b))
    codes = [code_in(side.run.info) for side in (a, b)]
    # What is played may differ: rows are paired, and the models are what is compared.
    same: dict[str, Any] = {"tasks": None, "models": None, "epochs": None, "model": {}, "seed": one["seed"]}
    sides = [
        {**each, **same, "code": {name: own for name, own in code.items() if name in codes[0] and name in codes[1]}}
        for each, code in zip((one, other), codes, strict=True)
    ]
    if told := asked_differently(*sides):
        yield f"settings differ: {told}"
    if a.model in one["model"] and b.model in other["model"]:
        sampling = ({"": each["model"][side.model]["options"]} for each, side in ((one, a), (other, b)))
        if told := differing(*sampling):
            yield f"the sampling differs: {told}"


def _of_seeds(a: Side, b: Side, paired: Sequence[Task]) -> list[str]:
    one, other = (grouped(side.rows, lambda row: (row.id, row.row)) for side in (a, b))
    differing = sum({row.seed for row in one[task]}.isdisjoint(row.seed for row in other[task]) for task in paired)
    return [f"the seeds differ in {differing} of {len(paired)} rows that both have"] if differing else []


def _of_records(a: Side, b: Side, paired: Sequence[Task], *, told: bool) -> Iterator[str]:
    """Compare the record of one row of each task; what holds for several tasks is said once.

    Args:
        a: The first side.
        b: The second.
        paired: The rows that both have.
        told: Whether the settings of both runs, which arguments and wrappers are part of, have been compared.
    """
    said: dict[str, str] = {}
    for task, row in {task: row for task, row in reversed(paired)}.items():
        try:
            one, other = (
                side.run.episode(next(each for each in side.rows if (each.id, each.row) == (task, row)))
                for side in (a, b)
            )
        except EpisodeFileError:
            continue  # whoever opens its transcript is told
        for difference in _record_differences(one, other, told=told):
            said.setdefault(difference, task)
    yield from (f"{difference} (as in {task})" for difference, task in said.items())


def _record_differences(one: Episode, other: Episode, *, told: bool) -> Iterator[str]:
    for name in sorted({*one.versions, *other.versions}):
        if one.versions.get(name) != other.versions.get(name):
            yield f"the versions of {name} differ: {one.versions.get(name)} and {other.versions.get(name)}"
    starts = {called: [to_plain(getattr(each, name)) for each in (one, other)] for name, called in _STARTS.items()}
    differing = {called: both for called, both in starts.items() if both[0] != both[1]}
    for called, (first, second) in ({} if told else differing).items():
        yield f"{called} differ: {short(first)} and {short(second)}"
    if not differing and one.seed == other.seed and to_plain(one.observation) != to_plain(other.observation):
        yield "the first observation of a row differs: its data or its prompt was changed"
