"""Tables and lines that fit a terminal."""

from __future__ import annotations

import io
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, islice
from typing import Any, Literal, NamedTuple

import click

_GAP = 2
_LEAST_TEXT = 24
_LEAST_COLUMN = 6
_ROWS_AHEAD = 200
_ANY_WIDTH = 100_000


def output_width() -> int | None:
    """Return the width of standard output in characters; None where it is no terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def echo_line(text: str, *, err: bool = False) -> None:
    """Write a line; a terminal that is too narrow for it gets it wrapped between words."""
    if (sys.stderr if err else sys.stdout).isatty():
        text = "\n".join(wrapped(text, shutil.get_terminal_size().columns))
    click.echo(text, err=err)


def wrapped(text: str, width: int | None, indent: int | None = None) -> list[str]:
    """Return a line as lines that fit a width, broken between words.

    Args:
        text: It may have colours.
        width: None for any width.
        indent: Spaces before the second line and all others; by default those of the first.
    """
    if width is None or len(click.unstyle(text)) <= width:
        return [text]
    if "\x1b" not in text:
        before = " " * (len(text) - len(text.lstrip(" ")) if indent is None else indent)
        room = max(width, len(before) + 20)
        return textwrap.wrap(text, room, subsequent_indent=before, break_long_words=False, break_on_hyphens=False)
    from rich.console import Console
    from rich.text import Text

    console = Console(
        file=io.StringIO(), width=width, force_terminal=True, color_system="standard", legacy_windows=False
    )
    console.print(Text.from_ansi(text), soft_wrap=False, highlight=False)
    return str(console.file.getvalue()).splitlines()  # type: ignore[attr-defined]


def counted(number: int, noun: str) -> str:
    """Return a number of things in words, as "1 episode" or "2 episodes"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def cut_at_word(text: str, width: int) -> str:
    """Return text in at most ``width`` characters, cut after a whole word, with a mark where it was cut."""
    if len(text) <= width:
        return text
    kept = text[: max(width - 1, 0)]
    if text[len(kept)] != " ":
        kept = kept.rpartition(" ")[0]
    return f"{kept.rstrip(' ,;:')}…" if kept.strip() else "…"[:width]


class Column(NamedTuple):
    """A column of a table.

    Args:
        header: What stands above it.
        cell: Returns what it shows of a row.
        dispensable: When it is left out of a table that is too wide: the lowest number first; None for never.
        alarm: Whether everything but 0 is shown in red.
        name: Whether it names the row.
        text: Whether it is text, which stands to the left and is cut at a word.
        colour: Returns the colour of a row's cell.
    """

    header: str
    cell: Callable[[Any], str]
    dispensable: int | None = None
    alarm: bool = False
    name: bool = False
    text: bool = False
    colour: Callable[[Any], str] | None = None

    def style(self, row: Any, cell: str) -> str:
        """Return the style of a cell, in the words of rich."""
        if self.colour is not None:
            return self.colour(row)
        return "cyan" if self.name else "red" if self.alarm and cell != "0" else ""


def print_table(columns: Sequence[Column], rows: Iterable[Any]) -> None:
    """Write a table to standard output, as wide as a terminal is."""
    for line in table_lines(columns, rows, output_width()):
        click.echo(line)


def table_lines(columns: Sequence[Column], rows: Iterable[Any], width: int | None) -> Iterator[str]:
    """Yield the lines of a table as its rows come, and a note of the columns that are left out.

    Args:
        columns: Those that name rows come first.
        rows: What the cells are made from; columns are as wide as the first few hundred need.
        width: Characters in a line: columns are left out to fit, then the widest are folded; None for any number.
    """
    rest = iter(rows)
    block = list(islice(rest, _ROWS_AHEAD))
    widths = _fitting_widths(columns, block, width)
    if width is None:  # plain lines: a file of a million episodes may go through a pipe
        cells = ([column.cell(row) for column in columns] for row in chain(block, rest))
        for line in chain([[column.header for column in columns]], cells):
            padded = (
                cell.ljust(widths[column]) if column.name or column.text else cell.rjust(widths[column])
                for column, cell in zip(columns, line, strict=True)
            )
            yield (" " * _GAP).join(padded).rstrip()
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    shown = [column for column in columns if column in widths]
    console = Console(file=io.StringIO(), width=_ANY_WIDTH, force_terminal=True, color_system="standard")
    first = True
    while block or first:
        table = Table(box=None, pad_edge=False, show_header=first, header_style="bold")
        for column in shown:
            justify: Literal["left", "right"] = "left" if column.name or column.text else "right"
            table.add_column(Text(column.header), justify=justify, width=widths[column], overflow="fold")
        for row in block:
            texts = []
            for column in shown:
                cell = column.cell(row)
                text = cut_at_word(cell, widths[column]) if column.text else cell
                texts.append(Text(text, column.style(row, cell)))
            table.add_row(*texts)
        with console.capture() as captured:
            console.print(table)
        yield from (line.rstrip() for line in captured.get().splitlines())
        block, first = list(islice(rest, _ROWS_AHEAD)), False
    left_out = [column.header for column in columns if column not in widths]
    if left_out:
        note = f"Too wide for this terminal: {', '.join(left_out)}."
        yield from (click.style(line, dim=True) for line in wrapped(note, width))


def _fitting_widths(columns: Sequence[Column], rows: Sequence[Any], width: int | None) -> dict[Column, int]:
    """Return the columns that are shown, each with its width."""
    from rich.cells import cell_len

    wanted = {column: max((cell_len(column.cell(row)) for row in rows), default=0) for column in columns}
    whole = {column: max(cells, len(column.header)) for column, cells in wanted.items()}
    if width is None or sum(whole.values()) + _GAP * (len(whole) - 1) <= width:
        return whole
    widths = {
        column: max(
            min(cells, _LEAST_TEXT) if column.text else cells, *(len(word) for word in (column.header or " ").split())
        )
        for column, cells in wanted.items()
    }

    def room() -> int:
        return width - sum(widths.values()) - _GAP * (len(widths) - 1)

    ranked = [(column.dispensable, place) for place, column in enumerate(columns) if column.dispensable is not None]
    for _, place in sorted(ranked):
        if room() < 0:
            del widths[columns[place]]
    while room() < 0 and max(widths.values()) > _LEAST_COLUMN:
        widths[max(widths, key=lambda column: widths[column])] -= 1
    for column in widths:
        if room() > 0:
            widths[column] = min(widths[column] + room(), whole[column])
    return widths
