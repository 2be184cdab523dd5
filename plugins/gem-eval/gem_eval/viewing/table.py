"""The table of episodes: filtered, sorted and counted here, so that a page asks only for the rows that it shows."""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from gem_core.records import to_plain
from gem_eval.filters import Comparison, parse_comparison
from gem_eval.show.text import escaped
from gem_eval.turns import outcome_of_row

if TYPE_CHECKING:
    from gem_eval.records import Row
    from gem_eval.viewing.library import ViewedRun


class Place(NamedTuple):
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

NUMBERS: dict[str, Callable[[Row], float | None]] = {
    "return": lambda row: row.episode_return,
    "turns": lambda row: row.turns,
    "tokens": _tokens,
    "cost": lambda row: row.cost,
    "seconds": lambda row: row.seconds,
}
"""What comparisons such as ``>0.5`` are made with."""

_TEXTS: dict[str, Callable[[Place], str]] = {
    "run": lambda place: place.run.name,
    "model": lambda place: place.row.model,
    "row": lambda place: place.row.row,
    "outcome": lambda place: outcome_of_row(place.row),
    "reason": lambda place: reason_of_row(place.row),
}
_ORDERS: dict[str, Callable[[Row], float | None]] = {
    "number": lambda row: row.number,
    "epoch": lambda row: row.epoch,
    "finished": lambda row: row.finished,
    **NUMBERS,
}


@dataclass(frozen=True)
class Query:
    """Which episodes a table has, and in which order.

    Args:
        outcomes: Names of ``OUTCOMES``, of which one must hold; empty for all.
        models: Names of models; empty for all.
        ids: Names of tasks; empty for all.
        reasons: See ``reason_of_row``; empty for all.
        row: The identity of one row; empty for all.
        text: Stands in the task, the row, the model, the error or the key; case does not count.
        numbers: Comparisons by name of ``NUMBERS``, separated by commas, as in ``">0.2, <0.8"``.
        sort: Name of a column; empty for the order in which episodes were written.
        reverse: The last first.

    Raises:
        ArgumentError: A comparison is none.
    """

    outcomes: tuple[str, ...] = ()
    models: tuple[str, ...] = ()
    ids: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    row: str = ""
    text: str = ""
    numbers: tuple[tuple[str, str], ...] = ()
    sort: str = ""
    reverse: bool = False
    _tests: list[Callable[[Row], bool]] = field(default_factory=list, compare=False, init=False)

    def __post_init__(self) -> None:
        """Make the tests."""
        tests = self._tests
        if self.outcomes:
            wanted = [OUTCOMES[name] for name in self.outcomes if name in OUTCOMES]
            tests.append(lambda row: any(test(row) for test in wanted))
        rows = (self.row,) if self.row else ()
        for names, of in ((self.models, _model), (self.ids, _id), (self.reasons, reason_of_row), (rows, _row)):
            if names:
                tests.append(_is_one_of(frozenset(names), of))
        for name, text in self.numbers:
            for comparison in filter(str.strip, text.split(",")):
                tests.append(_compares(NUMBERS[name], parse_comparison(comparison)))
        if self.text:
            wanted_text = self.text.casefold()
            tests.append(lambda row: wanted_text in _searched(row).casefold())

    def places(self, runs: Iterable[ViewedRun]) -> list[Place]:
        """Return the table."""
        found = []
        for viewed in runs:
            rows = viewed.rows
            for test in self._tests:
                rows = list(filter(test, rows))
            found += [Place(viewed, row) for row in rows]
        if self.sort in _TEXTS:
            found.sort(key=_TEXTS[self.sort], reverse=self.reverse)
        elif self.sort in _ORDERS:
            value_of = _ORDERS[self.sort]
            values = [value_of(row) for _, row in found]
            known = [place for place, value in enumerate(values) if value is not None and value == value]
            without = [place for place, value in enumerate(values) if value is None or value != value]
            known.sort(key=values.__getitem__, reverse=self.reverse)  # type: ignore[arg-type]  # there is no None
            found = [found[place] for place in known + without]
        elif self.reverse:
            found.reverse()
        return found


def _model(row: Row) -> str:
    return row.model


def _id(row: Row) -> str:
    return row.id


def _row(row: Row) -> str:
    return row.row


def _is_one_of(names: frozenset[str], of: Callable[[Row], str]) -> Callable[[Row], bool]:
    # A page knows only what is escaped.
    return lambda row: escaped(of(row)) in names


def _compares(value_of: Callable[[Row], float | None], comparison: Comparison) -> Callable[[Row], bool]:
    def test(row: Row) -> bool:
        value = value_of(row)
        return value is not None and comparison(value)

    return test


def _searched(row: Row) -> str:
    return f"{row.id}\n{row.row}\n{row.model}\n{row.error or ''}\n{row.key}\n{row.seed}"


class Table:
    """Answers queries; the latest answers are kept, since a page asks for them piece by piece as it scrolls."""

    _KEPT = 6

    def __init__(self) -> None:
        self._answers: OrderedDict[Any, Any] = OrderedDict()

    def places(self, query: Query, runs: Sequence[ViewedRun]) -> list[Place]:
        """Return the table of a query."""
        found: list[Place] = self._kept((query, _versions(runs)), lambda: query.places(runs))
        return found

    def summary(self, query: Query, runs: Sequence[ViewedRun]) -> dict[str, Any]:
        """Return how the episodes of a query came out, all together."""
        found: dict[str, Any] = self._kept(
            ("summary", query, _versions(runs)), lambda: _summary([place.row for place in self.places(query, runs)])
        )
        return found

    def choices(self, runs: Sequence[ViewedRun]) -> dict[str, Any]:
        """Return what some runs can be filtered by, with the number of episodes of each."""
        found: dict[str, Any] = self._kept(
            ("choices", _versions(runs)), lambda: _choices([row for viewed in runs for row in viewed.rows])
        )
        return found

    def _kept(self, key: Any, make: Callable[[], Any]) -> Any:
        # Two threads may make the same; the later one is kept.
        answer = self._answers.get(key)
        if answer is None:
            answer = self._answers[key] = make()
            while len(self._answers) > self._KEPT:
                self._answers.popitem(last=False)
        return answer


def _versions(runs: Sequence[ViewedRun]) -> tuple[tuple[str, int], ...]:
    return tuple((viewed.name, viewed.version) for viewed in runs)


def _summary(rows: Sequence[Row]) -> dict[str, Any]:
    # Of several agents somebody always wins, and the sum of their returns says nothing: their scores are by seat.
    alone = [row for row in rows if row.error is None and not row.seats]
    judged = [row.success for row in alone if row.success is not None]
    returns = [row.episode_return for row in alone if math.isfinite(row.episode_return)]
    costs = [row.cost for row in rows if row.cost is not None]
    return {
        "episodes": len(rows),
        "success": sum(judged) / len(judged) if judged else None,
        "judged": len(judged),
        "return": sum(returns) / len(returns) if returns else None,
        "errors": sum(row.error is not None for row in rows),
        "cost": sum(costs) if costs else None,
    }


def _choices(rows: Sequence[Row]) -> dict[str, Any]:
    def counted(values: Iterable[str], most: int = 500) -> list[list[Any]]:
        return [[escaped(value), count] for value, count in Counter(values).most_common(most) if value]

    return {
        "outcomes": [[name, sum(map(test, rows))] for name, test in OUTCOMES.items()],
        "models": counted(row.model for row in rows),
        "ids": counted(row.id for row in rows),
        "reasons": counted(map(reason_of_row, rows)),
        "columns": [
            name
            for name, has in {
                "epoch": lambda row: row.epoch > 0,
                "tokens": lambda row: _tokens(row) is not None,
                "cost": lambda row: row.cost is not None,
                "seconds": lambda row: row.seconds is not None,
                "reason": lambda row: bool(reason_of_row(row)),
            }.items()
            if any(map(has, rows))
        ],
    }


def row_data(place: Place) -> dict[str, Any]:
    """Return a row of the table as plain JSON, its texts escaped."""
    row = place.row
    record: dict[str, Any] = to_plain(
        {
            "run": escaped(place.run.name),
            "number": row.number,
            "id": escaped(row.id),
            "model": escaped(row.model),
            "row": escaped(row.row),
            "epoch": row.epoch,
            "outcome": outcome_of_row(row),
            "cutOff": row.cut_off is not None,
            "reason": escaped(reason_of_row(row)),
            "error": escaped(row.error or ""),
            "return": row.episode_return,
            "turns": row.turns,
            "tokens": _tokens(row),
            "cost": row.cost,
            "seconds": row.seconds,
        }
    )
    return record
