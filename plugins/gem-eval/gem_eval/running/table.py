"""The table of scores that ``gem eval`` prints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from gem_core.cli import Column, echo_line, print_table, shown, shown_count
from gem_eval import figures

if TYPE_CHECKING:
    from gem_eval.records import Row
    from gem_eval.scores import Score
    from gem_eval.statistics import Estimate

_COUNTS = (("unscored", "unscored"), ("unreadable", "unreadable"), ("cut off", "truncated"))
"""Headers of counts, and their names in a score: the most dispensable first."""


@dataclass
class TableRow:
    """A row of the table: a model at a task, or at all of them.

    Args:
        scores: Its scores by metric; success is missing where the task never tells.
        episodes: Its episodes, those with an error too: they took tokens as well.
    """

    scores: dict[str, Score] = field(default_factory=dict)
    episodes: list[Row] = field(default_factory=list)

    @property
    def success(self) -> Score | None:
        """The score by success."""
        return self.scores.get("success")

    @property
    def main(self) -> Score:
        """The score that the counts are read from."""
        return self.success or self.scores["return"]

    def total(self, name: str) -> float | None:
        """Return what the episodes took; None where it is not known of any."""
        known = [value for row in self.episodes if (value := getattr(row, name)) is not None]
        return sum(known) if known else None


def print_scores(scores: Sequence[Score], episodes: Iterable[Row]) -> None:
    """Write the table of scores to standard output; columns that say nothing are left out."""
    found: dict[tuple[str, str], TableRow] = {}
    for score in scores:
        found.setdefault((score.id, score.model), TableRow()).scores[score.metric] = score
    for episode in episodes:
        for task in (episode.id, "all"):
            if (task, episode.model) in found:
                found[task, episode.model].episodes.append(episode)
    print_table(_columns(list(found.values())), list(found.values()))
    for note in filter(None, map(figures.pass_note, scores)):
        echo_line(note)


def _columns(rows: Sequence[TableRow]) -> list[Column]:
    by_success = [row.success for row in rows if row.success]
    epochs = max((int(k) for score in by_success for k in score.pass_at), default=1)
    k, repeated = str(epochs), epochs > 1
    tokens = any(row.total(name) is not None for row in rows for name in ("tokens_in", "tokens_out"))
    columns = [
        (True, Column("task", lambda row: str(row.main.id), name=True)),
        (True, Column("model", lambda row: str(row.main.model), name=True)),
        (True, Column("episodes", lambda row: str(row.main.episodes), 9)),
        (repeated, Column("rows", lambda row: str(row.main.rows), 8)),
        (by_success, Column("success [95 %]", lambda row: figures.with_bounds(row.success, "success"))),
        (repeated, Column(f"pass@{k}", lambda row: _mean_of(row.success and row.success.pass_at.get(k)))),
        (repeated, Column(f"pass^{k}", lambda row: _mean_of(row.success and row.success.pass_hat.get(k)))),
        (
            any(score.without_truncated for score in by_success),
            Column("without cut-off", lambda row: _mean_of(row.success and row.success.without_truncated), 6),
        ),
        (
            any(row.main.errors for row in rows),
            Column(
                "if errors failed", lambda row: figures.score(row.success and row.success.with_errors, "success"), 5
            ),
        ),
        (True, Column("return [95 %]", lambda row: figures.with_bounds(row.scores.get("return"), "return"), 7)),
        *(
            (any(getattr(row.main, name) for row in rows), Column(header, partial(_count, name), rank))
            for rank, (header, name) in enumerate(_COUNTS, start=2)
        ),
        (True, Column("errors", lambda row: str(row.main.errors), alarm=True)),
        (tokens, Column("tokens in", partial(_total, "tokens_in"), 0)),
        (tokens, Column("tokens out", partial(_total, "tokens_out"), 1)),
        (
            any(row.total("cost") is not None for row in rows),
            Column("cost $", lambda row: shown(row.total("cost"), ",.4f")),
        ),
    ]
    return [column for is_told, column in columns if is_told]


def _count(name: str, row: TableRow) -> str:
    return str(getattr(row.main, name))


def _total(name: str, row: TableRow) -> str:
    total = row.total(name)
    return shown_count(None if total is None else int(total))


def _mean_of(estimate: Estimate | None) -> str:
    return figures.score(None if estimate is None else estimate.mean, "success")
