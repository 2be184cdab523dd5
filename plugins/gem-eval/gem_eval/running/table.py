"""The table of scores that ``gem eval`` prints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from gem_core.cli import Column, echo_line, print_table, shown, shown_count
from gem_eval import figures

if TYPE_CHECKING:
    from gem_eval.records import Row
    from gem_eval.scores import Score
    from gem_eval.statistics import Estimate


@dataclass
class TableRow:
    """A row of the table: a model at a task, or at all of them.

    Args:
        id: Name of the task.
        model: Name of the model.
        success: Its score by success; None where the task never tells.
        returns: Its score by return.
        tokens_in: Tokens read; None where no server tells.
        tokens_out: Tokens written.
        cost: US dollars; None without a price.
    """

    id: str
    model: str
    success: Score | None = None
    returns: Score | None = None
    tokens_in: int | None = None
    tokens_out: int | None = None
    cost: float | None = None

    @property
    def main(self) -> Score:
        """The score that the counts are read from."""
        score = self.success or self.returns
        if score is None:
            raise LookupError(f"{self.id} has no score")
        return score

    def count(self, row: Row) -> None:
        """Add what an episode took; errors took it, too."""
        if row.tokens_in is not None:
            self.tokens_in = (self.tokens_in or 0) + row.tokens_in
        if row.tokens_out is not None:
            self.tokens_out = (self.tokens_out or 0) + row.tokens_out
        if row.cost is not None:
            self.cost = (self.cost or 0.0) + row.cost


def table_rows(scores: Iterable[Score], episodes: Iterable[Row]) -> list[TableRow]:
    """Return the rows of the table."""
    found: dict[tuple[str, str], TableRow] = {}
    for score in scores:
        row = found.setdefault((score.id, score.model), TableRow(score.id, score.model))
        if score.metric == "success":
            row.success = score
        else:
            row.returns = score
    for episode in episodes:
        for key in ((episode.id, episode.model), ("all", episode.model)):
            if key in found:
                found[key].count(episode)
    return list(found.values())


def print_scores(scores: Sequence[Score], episodes: Iterable[Row]) -> None:
    """Write the table of scores to standard output; columns that say nothing are left out."""
    rows = table_rows(scores, episodes)
    print_table(_columns(rows), rows)
    for note in filter(None, (figures.pass_note(score) for score in scores)):
        echo_line(note)


def _columns(rows: Sequence[TableRow]) -> list[Column]:
    epochs = sorted({int(k) for row in rows if row.success for k in row.success.pass_at if int(k) > 1})
    columns = [
        Column("task", lambda row: str(row.id), name=True),
        Column("model", lambda row: str(row.model), name=True),
        Column("episodes", lambda row: str(row.main.episodes), 9),
    ]
    if epochs:
        columns.append(Column("rows", lambda row: str(row.main.rows), 8))
    if any(row.success for row in rows):
        columns.append(Column("success [95 %]", lambda row: figures.with_bounds(row.success, "success")))
    for k in epochs[-1:]:
        columns += [Column(f"pass@{k}", partial(_pass_at, k)), Column(f"pass^{k}", partial(_pass_hat, k))]
    if any(row.success and row.success.without_truncated for row in rows):
        columns.append(
            Column("without cut-off", lambda row: _mean_of(row.success and row.success.without_truncated), 6)
        )
    if any(row.main.errors for row in rows):
        columns.append(
            Column("if errors failed", lambda row: figures.score(row.success and row.success.with_errors, "success"), 5)
        )
    columns.append(Column("return [95 %]", lambda row: figures.with_bounds(row.returns, "return"), 7))
    for rank, (header, name) in enumerate(_COUNTS, start=2):
        if any(getattr(row.main, name) for row in rows):
            columns.append(Column(header, partial(_count, name), rank))
    columns.append(Column("errors", lambda row: str(row.main.errors), alarm=True))
    if any(row.tokens_in is not None or row.tokens_out is not None for row in rows):
        columns += [
            Column("tokens in", lambda row: shown_count(row.tokens_in), 0),
            Column("tokens out", lambda row: shown_count(row.tokens_out), 1),
        ]
    if any(row.cost is not None for row in rows):
        columns.append(Column("cost $", lambda row: shown(row.cost, ",.4f")))
    return columns


_COUNTS = (("unscored", "unscored"), ("unreadable", "unreadable"), ("cut off", "truncated"))
"""Headers of counts, and their names in a score: the most dispensable first."""


def _pass_at(k: int, row: TableRow) -> str:
    return _mean_of(row.success.pass_at.get(str(k)) if row.success else None)


def _pass_hat(k: int, row: TableRow) -> str:
    return _mean_of(row.success.pass_hat.get(str(k)) if row.success else None)


def _count(name: str, row: TableRow) -> str:
    return str(getattr(row.main, name))


def _mean_of(estimate: Estimate | None) -> str:
    return figures.score(None if estimate is None else estimate.mean, "success")
