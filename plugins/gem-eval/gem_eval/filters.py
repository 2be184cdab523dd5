"""Filter and sort the episodes of a run."""

from __future__ import annotations

import fnmatch
import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from operator import eq, ge, gt, le, lt, ne
from typing import TYPE_CHECKING, Any

from gem_core.errors import ArgumentError
from gem_eval.text_search import found_in

if TYPE_CHECKING:
    from gem_eval.records import Row, Run

Comparison = Callable[[float], bool]

_OPERATORS = {">=": ge, "<=": le, "!=": ne, "==": eq, ">": gt, "<": lt, "=": eq, "": eq}
_COMPARISON = re.compile(r"\s*(>=|<=|!=|==|>|<|=|)\s*(\S+)\s*")

SORTS: dict[str, Callable[[Row], Any]] = {
    "number": lambda row: row.number,
    "env": lambda row: row.id,
    "success": lambda row: -1 if row.success is None else int(row.success),
    "return": lambda row: -math.inf if math.isnan(row.episode_return) else row.episode_return,
    "turns": lambda row: row.turns,
    "seed": lambda row: -1 if row.seed is None else row.seed,
    "group": lambda row: row.group or "",
}
"""What episodes can be sorted by; those that are alike stay in the order of the file."""


def select(
    run: Run,
    rows: Iterable[Row],
    *,
    env: str | None = None,
    model: str | None = None,
    success: bool | None = None,
    returns: Comparison | None = None,
    errors: bool | None = None,
    group: str | None = None,
    grep: str | None = None,
) -> Iterator[Row]:
    """Yield those rows of a run that fit all conditions, as they come.

    Args:
        run: The run.
        rows: Its rows, or those of one seat.
        env: Part of the id, or a glob for the whole of it.
        model: Part of the name of the agent, or a glob for the whole of it.
        success: True for those that solved the task, False for those that are known not to have; see ``Row``.
        returns: A test of the return; of several agents, of their sum.
        errors: True for those with an error of the machinery, False for those without.
        group: The group's name.
        grep: Text that stands in an observation, a response or an info; case does not count.
    """
    for row in rows:
        if (
            (env is None or matches_id(row.id, env))
            and (model is None or matches_id(row.model, model))
            and (success is None or row.success is success)
            and (returns is None or returns(row.episode_return))
            and (errors is None or (row.error is not None) is errors)
            and (group is None or row.group == group)
            and (grep is None or found_in(run, row, grep) is not None)
        ):
            yield row


def at_seat(rows: Iterable[Row], seat: str) -> Iterator[Row]:
    """Yield the rows of one seat alone, of those episodes that have it."""
    for row in rows:
        own = (row.seats or {}).get(seat)
        if own is not None:
            yield replace(own, seats={seat: own})


def ordered(rows: Iterable[Row], sort: str | None, reverse: bool, limit: int | None) -> Iterator[Row]:
    """Yield rows in order, up to a limit; without a sort as they come.

    Args:
        rows: What fits.
        sort: A name of ``SORTS``; None keeps the order.
        reverse: The last first.
        limit: How many at most.
    """
    if sort is not None or reverse:
        rows = sorted(rows, key=SORTS[sort or "number"], reverse=reverse)
    return islice(rows, limit)


def matches_id(env_id: str, pattern: str) -> bool:
    """Whether an id fits: a glob fits the whole, anything else a part, and case does not count."""
    if any(character in pattern for character in "*?["):
        return fnmatch.fnmatchcase(env_id.casefold(), pattern.casefold())
    return pattern.casefold() in env_id.casefold()


def parse_comparison(text: str) -> Comparison:
    """Return the test that a comparison such as ``">0.5"`` stands for.

    Raises:
        ArgumentError: It is no comparison with a number.
    """
    found = _COMPARISON.fullmatch(text)
    try:
        if found is None:
            raise ValueError
        compare, bound = _OPERATORS[found[1]], float(found[2])
    except ValueError:
        raise ArgumentError(
            f"{text!r} is no comparison with a number; write '>0.5', '>=0.5', '<0.5', '<=0.5', '=1' or '!=0', in quotes"
        ) from None
    return lambda value: compare(value, bound)
