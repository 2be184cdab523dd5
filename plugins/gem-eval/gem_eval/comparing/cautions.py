"""Why two runs may not be comparable: they differ in more than who acted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from gem_core.cli import counted
from gem_eval.grouping import grouped
from gem_eval.settings import asked_differently, asked_of, code_in, differing

if TYPE_CHECKING:
    from gem_eval.comparing.sides import Side, Task


def cautions_of(a: Side, b: Side, paired: Sequence[Task]) -> list[str]:
    """Return in words what two sides differ in besides their models.

    Compared are the seeds of rows, and, where there is a ``run.json``, arguments, code and hash of the data of the
    tasks that both have, the limits, the roles of models, and how the models were sampled.

    Args:
        a: The first side.
        b: The second.
        paired: The rows that both have.
    """
    runs = [a.run] if a.run is b.run else [a.run, b.run]
    found = [f"{counted(run.damaged, 'line')} of {run.path} cannot be read, left out" for run in runs if run.damaged]
    if all(run.info for run in runs):
        found += _of_settings(a, b)
    return found + _of_seeds(a, b, paired)


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
