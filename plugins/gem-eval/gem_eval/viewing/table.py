"""The table of episodes: filtered, sorted and counted here, so that a page asks only for the rows that it shows."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from gem_core.records import to_plain
from gem_eval.filters import Comparison, parse_comparison
from gem_eval.show.text import escaped
from gem_eval.turns import outcome_of_row

if TYPE_CHECKING:
    from gem_eval.records import Row
    from gem_eval.viewing.library import ViewedRun


class TableRow(NamedTuple):
    """A row of the table: an episode of a run."""

    run: ViewedRun
    row: Row


def reason_of_row(row: Row) -> str:
    """Return why an episode has its outcome: the cause of an error, a cut-off, an unreadable end, who succeeded."""
    reason = row.cause or row.cut_off or ("unreadable" if row.unreadable else "")
    if not reason and outcome_of_row(row) == "split":
        return f"success: {', '.join(seat for seat, own in (row.seats or {}).items() if own.success) or '-'}"
    return reason


def _tokens(row: Row) -> int | None:
    return None if row.tokens_in is None and row.tokens_out is None else (row.tokens_in or 0) + (row.tokens_out or 0)


OUTCOMES: dict[str, Callable[[Row], bool]] = {
    "success": lambda row: outcome_of_row(row) == "success",
    "failure": lambda row: outcome_of_row(row) == "failure",
    "split": lambda row: outcome_of_row(row) == "split",
    "unscored": lambda row: outcome_of_row(row) == "unscored",
    "error": lambda row: row.error is not None,
    "cut off": lambda row: row.cut_off is not None,
    "unreadable": lambda row: row.unreadable,
}
"""What episodes are filtered by; one may be both a failure and cut off."""

NAMES: dict[str, Callable[[Row], str]] = {
    "model": lambda row: row.model,
    "id": lambda row: row.id,
    "row": lambda row: row.row,
    "reason": reason_of_row,
}
"""What episodes are filtered by as a whole."""

NUMBERS: dict[str, Callable[[Row], float | None]] = {
    "return": lambda row: row.episode_return,
    "turns": lambda row: row.turns,
    "tokens": _tokens,
    "cost": lambda row: row.cost,
    "seconds": lambda row: row.seconds,
}
"""What comparisons such as ``>0.5`` are made with."""

_ORDERS: dict[str, Callable[[Row], Any]] = {
    **NAMES,
    **NUMBERS,
    "outcome": outcome_of_row,
    "number": lambda row: row.number,
    "epoch": lambda row: row.epoch,
    "finished": lambda row: row.finished,
}


@dataclass(frozen=True)
class Query:
    """Which episodes a table has, and in which order.

    Args:
        outcomes: Names of ``OUTCOMES``, of which one must hold; empty for all.
        names: By name of ``NAMES``, the values of which one must be had.
        text: Stands in the task, the row, the model, the error or the key; case does not count.
        numbers: Comparisons by name of ``NUMBERS``, separated by commas, as in ``">0.2, <0.8"``.
        sort: Name of a column; empty for the order in which episodes were written.
        reverse: The last first.
    """

    outcomes: tuple[str, ...] = ()
    names: tuple[tuple[str, tuple[str, ...]], ...] = ()
    text: str = ""
    numbers: tuple[tuple[str, str], ...] = ()
    sort: str = ""
    reverse: bool = False

    def tests(self) -> Iterator[Callable[[Row], bool]]:
        """Yield the tests that a row must pass.

        Raises:
            ArgumentError: A comparison is none.
        """
        if self.outcomes:
            wanted = [OUTCOMES[name] for name in self.outcomes if name in OUTCOMES]
            yield lambda row: any(test(row) for test in wanted)
        for name, values in self.names:
            yield _named(NAMES[name], frozenset(values))
        for name, text in self.numbers:
            for comparison in filter(str.strip, text.split(",")):
                yield _compared(NUMBERS[name], parse_comparison(comparison))
        if self.text:
            sought = self.text.casefold()
            yield lambda row: sought in _searched(row).casefold()

    def places(self, runs: Sequence[ViewedRun]) -> list[TableRow]:
        """Return the table; what has no value in the column of the order comes last."""
        found, tests = [], list(self.tests())
        for viewed in runs:
            rows = viewed.rows
            for test in tests:
                rows = list(filter(test, rows))
            found += [TableRow(viewed, row) for row in rows]
        if self.sort == "run":
            return sorted(found, key=lambda place: place.run.name, reverse=self.reverse)
        if self.sort not in _ORDERS:
            return found[::-1] if self.reverse else found
        values = [_ORDERS[self.sort](row) for _, row in found]
        known = [place for place, value in enumerate(values) if value is not None and value == value]
        without = [place for place, value in enumerate(values) if value is None or value != value]
        known.sort(key=values.__getitem__, reverse=self.reverse)
        return [found[place] for place in known + without]


def _named(name_of: Callable[[Row], str], names: frozenset[str]) -> Callable[[Row], bool]:
    return lambda row: escaped(name_of(row)) in names  # a page knows only what is escaped


def _compared(value_of: Callable[[Row], float | None], holds: Comparison) -> Callable[[Row], bool]:
    return lambda row: (value := value_of(row)) is not None and holds(value)


def _searched(row: Row) -> str:
    return f"{row.id}\n{row.row}\n{row.model}\n{row.error or ''}\n{row.key}\n{row.seed}"


Versions = tuple[tuple["ViewedRun", int], ...]
"""Runs, each with the version of its rows."""


# A page asks piece by piece as it scrolls: of 100,000 rows, each answer would take 0.7 s.
@lru_cache(maxsize=6)
def answer(query: Query, versions: Versions) -> tuple[list[TableRow], dict[str, Any]]:
    """Return the table of a query, and how its episodes came out, all together."""
    places = query.places([viewed for viewed, _ in versions])
    rows = [place.row for place in places]
    # Of several agents somebody always wins, and the sum of their returns says nothing: their scores are by seat.
    alone = [row for row in rows if row.error is None and not row.seats]
    judged = [row.success for row in alone if row.success is not None]
    returns = [row.episode_return for row in alone if math.isfinite(row.episode_return)]
    costs = [row.cost for row in rows if row.cost is not None]
    return places, {
        "episodes": len(rows),
        "success": sum(judged) / len(judged) if judged else None,
        "judged": len(judged),
        "return": sum(returns) / len(returns) if returns else None,
        "errors": sum(row.error is not None for row in rows),
        "cost": sum(costs) if costs else None,
    }


@lru_cache(maxsize=6)
def choices(versions: Versions) -> dict[str, Any]:
    """Return what some runs can be filtered by, with the number of episodes of each."""
    rows = [row for viewed, _ in versions for row in viewed.rows]

    def counted(name: str) -> list[list[Any]]:
        found = Counter(map(NAMES[name], rows)).most_common(500)
        return [[escaped(value), count] for value, count in found if value]

    has: dict[str, Callable[[Row], bool]] = {
        "epoch": lambda row: row.epoch > 0,
        "tokens": lambda row: _tokens(row) is not None,
        "cost": lambda row: row.cost is not None,
        "seconds": lambda row: row.seconds is not None,
        "reason": lambda row: bool(reason_of_row(row)),
    }
    return {
        "outcomes": [[name, sum(map(test, rows))] for name, test in OUTCOMES.items()],
        "models": counted("model"),
        "ids": counted("id"),
        "reasons": counted("reason"),
        "columns": [name for name, test in has.items() if any(map(test, rows))],
    }


def row_data(place: TableRow) -> dict[str, Any]:
    """Return a row of the table as plain JSON, its texts escaped."""
    row = place.row
    record: dict[str, Any] = to_plain(
        {
            "run": escaped(place.run.name),
            **{name: escaped(value_of(row)) for name, value_of in NAMES.items()},
            **{name: value_of(row) for name, value_of in NUMBERS.items()},
            "number": row.number,
            "epoch": row.epoch,
            "outcome": outcome_of_row(row),
            "cutOff": row.cut_off is not None,
            "error": escaped(row.error or ""),
        }
    )
    return record
