"""The table that ``gem run`` prints at the end."""

from __future__ import annotations

import textwrap
from functools import partial

import click

from gem_core.cli.layout import Layout, Style, output_width
from gem_core.records.summary import EnvSummary, RunSummary

_HEADERS = (
    "environment", "episodes", "judged", "success", "mean return", "mean turns", "out of turns", "out of tokens",
    "errors", "turns/s", "tokens in", "tokens out",
)  # fmt: skip
_TOKENS = 10, 11
_ERRORS = _HEADERS.index("errors")
_DISPENSABLE = [
    _HEADERS.index(name) for name in ("turns/s", "mean turns", "tokens in", "tokens out", "mean return")
] + [_HEADERS.index(name) for name in ("out of tokens", "out of turns", "episodes", "judged")]


def print_table(summary: RunSummary, seconds: float) -> None:
    """Write the table of a run to standard output, as wide as a terminal is.

    The tokens that a model read and wrote have columns where its server reports them.
    """
    reported = summary.total.prompt_tokens is not None or summary.total.completion_tokens is not None
    shown = len(_HEADERS) if reported else _TOKENS[0]
    rows = [_cells(row, seconds)[:shown] for row in summary.rows()]
    dispensable = [place for place in _DISPENSABLE if place < shown]
    layout = Layout(_HEADERS[:shown], rows, output_width(), dispensable=dispensable)
    for line in layout.header():
        click.echo(click.style(line, bold=True))
    for row in rows:
        styles: dict[int, Style] = {0: partial(click.style, fg="cyan")}
        if row[_ERRORS] != "0":
            styles[_ERRORS] = partial(click.style, fg="red")
        for line in layout.row(row, styles):
            click.echo(line)
    if layout.left_out:
        missing = f"Not shown here: {', '.join(layout.left_out)}."
        for line in textwrap.wrap(missing, output_width() or len(missing), break_on_hyphens=False):
            click.echo(click.style(line, dim=True))


def _cells(row: EnvSummary, seconds: float) -> tuple[str, ...]:
    return (
        row.label,
        str(row.episodes),
        str(row.judged),
        _with_error(row.success_rate, row.success_standard_error, ".1%"),
        _with_error(row.mean_return, row.return_standard_error, ".3f"),
        _shown(row.mean_turns, ".1f"),
        str(row.cut_off_by_turns),
        str(row.cut_off_by_tokens),
        str(row.errors),
        _shown(row.turns_per_second(seconds), ",.0f"),
        _count(row.prompt_tokens),
        _count(row.completion_tokens),
    )


def status_of(summary: RunSummary) -> str:
    """Return the scores of a run so far, for the progress line; of several agents, the mean return of each."""
    total = summary.total
    if summary.by_seat:
        several = len({agent for _, agent in summary.by_agent}) > 1
        returns: dict[str, list[EnvSummary]] = {}
        for row in summary.by_seat.values():
            returns.setdefault(str(row.agent if several else row.seat), []).append(row)
        parts = [f"return of {name} {_mean_return(rows)}" for name, rows in returns.items()]
    else:
        parts = [f"success {_shown(total.success_rate, '.0%')}", f"return {_shown(total.mean_return, '.2f')}"]
    if summary.errors:
        parts.append(f"{summary.errors} errors")
    return ", ".join(parts)


def _mean_return(rows: list[EnvSummary]) -> str:
    episodes = sum(row.episodes for row in rows)
    return _shown(sum(row.total_return for row in rows) / episodes if episodes else None, ".2f")


def _with_error(number: float | None, error: float | None, form: str) -> str:
    shown = _shown(number, form)
    return shown if error is None else f"{shown} ± {format(error, form)}"


def _shown(number: float | None, form: str) -> str:
    return "-" if number is None else format(number, form)


def _count(number: int | None) -> str:
    """Show a large count in few characters: 999, 12.3k, 4.5M."""
    if number is None:
        return "-"
    for unit, size in (("M", 10**6), ("k", 10**3)):
        if number >= size:
            return f"{number / size:,.1f}{unit}"
    return str(number)
