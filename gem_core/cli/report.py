"""Tables of scores: what ``gem run`` prints at the end, and commands of plugins likewise."""

from __future__ import annotations

from gem_core.cli.layout import Column, shown, shown_count
from gem_core.records.summary import RunSummary


def run_columns(summary: RunSummary, seconds: float) -> list[Column]:
    """Return the columns of the table of ``gem run``; counts that are 0 in every row have none."""
    total = summary.total
    columns = [
        Column("environment", lambda row: str(row.label), name=True),
        Column("episodes", lambda row: str(row.episodes), 7),
        Column("success", lambda row: _with_error(row.success_rate, row.success_standard_error, ".1%")),
        Column("mean return", lambda row: _with_error(row.mean_return, row.return_standard_error, ".3f")),
        Column("mean turns", lambda row: shown(row.mean_turns, ".1f"), 1),
        Column("turns/s", lambda row: shown(row.turns_per_second(seconds), ",.0f"), 0),
    ]
    if total.judged != total.episodes:
        columns.insert(2, Column("judged", lambda row: str(row.judged), 6))
    if total.cut_off_by_turns:
        columns.append(Column("out of turns", lambda row: str(row.cut_off_by_turns), 5))
    if total.cut_off_by_tokens:
        columns.append(Column("out of tokens", lambda row: str(row.cut_off_by_tokens), 4))
    if total.cut_off_by_limits:
        columns.append(Column("out of limits", lambda row: str(row.cut_off_by_limits)))
    if total.errors:
        columns.append(Column("errors", lambda row: str(row.errors), alarm=True))
    if total.prompt_tokens is not None or total.completion_tokens is not None:
        columns += [
            Column("tokens in", lambda row: shown_count(row.prompt_tokens), 2),
            Column("tokens out", lambda row: shown_count(row.completion_tokens), 3),
        ]
    return columns


def status_of(summary: RunSummary) -> str:
    """Return the scores of a run so far, for the progress line; of several agents, the mean return at each seat."""
    total = summary.total
    if summary.by_seat:
        parts = [f"return of {row.seat} {shown(row.mean_return, '.2f')}" for row in list(summary.by_seat.values())[:4]]
    else:
        parts = [f"success {shown(total.success_rate, '.0%')}", f"return {shown(total.mean_return, '.2f')}"]
    return ", ".join([*parts, *([f"{summary.errors} errors"] if summary.errors else [])])


def _with_error(number: float | None, error: float | None, form: str) -> str:
    text = shown(number, form)
    return text if error is None else f"{text} ± {format(error, form)}"
