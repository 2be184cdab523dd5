"""What ``gem run`` shows at the end: a table."""

from __future__ import annotations

import sys

import click

from gem_core.summary import EnvSummary, RunSummary

_HEADERS = ("environment", "episodes", "success", "mean return", "mean turns", "turns/s", "errors")
_TOKEN_HEADERS = ("tokens in", "tokens out")
_ERRORS = _HEADERS.index("errors")


def print_table(summary: RunSummary, seconds: float) -> None:
    """Write the table of a run to standard output: drawn in a terminal, in plain columns otherwise.

    The tokens that a model read and wrote have columns where its server reports them.
    """
    with_tokens = summary.total.prompt_tokens is not None or summary.total.completion_tokens is not None
    headers = (*_HEADERS, *_TOKEN_HEADERS) if with_tokens else _HEADERS
    rows = [_cells(row, seconds, with_tokens) for row in summary.rows()]
    if sys.stdout.isatty():
        _print_drawn(headers, rows)
        return
    widths = [max(map(len, column)) for column in zip(headers, *rows, strict=True)]
    for row in (headers, *rows):
        cells = [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        click.echo("  ".join(cells))


def _print_drawn(headers: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    widths = [max(map(len, column)) for column in zip(headers, *rows, strict=True)]
    # Where the frame does not fit, figures stay whole: no frame, headers of two lines and, if need be, ids folded.
    fits = sum(widths) + 3 * len(widths) + 1 <= console.width
    table = Table() if fits else Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for header, *column in zip(headers, *rows, strict=True):
        if header == "environment":
            table.add_column(header, overflow="fold")
        else:
            shown = header if fits else header.replace(" ", "\n")
            least = max(map(len, [*shown.split("\n"), *column]))
            table.add_column(shown, justify="right", no_wrap=True, min_width=least)
    for row in rows:
        style = "bold" if row[0] == "all" and len(rows) > 1 else None
        errors = row[_ERRORS] if row[_ERRORS] == "0" else f"[red]{row[_ERRORS]}[/red]"
        table.add_row(*row[:_ERRORS], errors, *row[_ERRORS + 1 :], style=style)
    console.print(table)


def _cells(row: EnvSummary, seconds: float, with_tokens: bool) -> tuple[str, ...]:
    tokens = (_count(row.prompt_tokens), _count(row.completion_tokens)) if with_tokens else ()
    return (
        row.id,
        str(row.episodes),
        _shown(row.success_rate, ".1%"),
        _shown(row.mean_return, ".3f"),
        _shown(row.mean_turns, ".1f"),
        _shown(row.turns_per_second(seconds), ",.0f"),
        str(row.errors),
        *tokens,
    )


def status_of(total: EnvSummary) -> str:
    """Return how good a run is so far, for the line that shows how far it is."""
    parts = [f"success {_shown(total.success_rate, '.0%')}", f"return {_shown(total.mean_return, '.2f')}"]
    if total.errors:
        parts.append(f"{total.errors} errors")
    return ", ".join(parts)


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
