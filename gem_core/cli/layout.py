"""Tables and lines that fit a terminal."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import click

_GAP = 2
_LEAST_TEXT = 24


def output_width() -> int | None:
    """Return the width of standard output in characters; None if it is no terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def echo_line(text: str, *, err: bool = False) -> None:
    """Write a line; a terminal that is too narrow for it gets it wrapped between words."""
    if (sys.stderr if err else sys.stdout).isatty():
        text = "\n".join(wrapped(text, shutil.get_terminal_size().columns))
    click.echo(text, err=err)


def wrapped(text: str, width: int | None, indent: int | None = None) -> list[str]:
    """Return a line as lines that fit a width, broken between words.

    Args:
        text: It may have colours, which are lost where it is broken.
        width: None for any width.
        indent: Spaces before the second line and all others; by default those of the first.
    """
    if width is None or len(click.unstyle(text)) <= width:
        return [text]
    text = click.unstyle(text)
    before = " " * (len(text) - len(text.lstrip(" ")) if indent is None else indent)
    room = max(width, len(before) + 20)
    return textwrap.wrap(text, room, subsequent_indent=before, break_long_words=False, break_on_hyphens=False)


def counted(number: int, noun: str) -> str:
    """Return a number of things in words, as "1 episode" or "2 episodes"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def shown(number: float | None, form: str) -> str:
    """Show a number in a form, and a dash if there is none."""
    return "-" if number is None else format(number, form)


def shown_count(number: int | None) -> str:
    """Show a large count in few characters: 999, 12.3k, 4.5M."""
    if number is None:
        return "-"
    for unit, size in (("M", 10**6), ("k", 10**3)):
        if number >= size:
            return f"{number / size:,.1f}{unit}"
    return str(number)


def cut_at_word(text: str, width: int) -> str:
    """Return text in at most ``width`` characters, cut after a whole word, with a mark where it was cut."""
    return text if len(text) <= width else f"{text[:width].rpartition(' ')[0].rstrip(' ,;:')}…"[:width]


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

    def padded(self, cell: str, width: int) -> str:
        """Return a cell as wide as its column."""
        text = cut_at_word(cell, width) if self.text else cell
        blanks = " " * (width - _cells(text))
        return text + blanks if self.name or self.text else blanks + text

    def coloured(self, row: Any, padded: str) -> str:
        """Return a padded cell in its colour."""
        default = "cyan" if self.name else "red" if self.alarm and padded.strip() != "0" else ""
        colour = self.colour(row) if self.colour else default
        return click.style(padded, fg=colour) if colour else padded


def print_table(columns: Sequence[Column], rows: Iterable[Any]) -> None:
    """Write a table to standard output, as wide as a terminal is."""
    for line in table_lines(columns, rows, output_width()):
        click.echo(line)


def table_lines(columns: Sequence[Column], rows: Iterable[Any], width: int | None) -> Iterator[str]:
    """Yield the lines of a table, and a note of the columns that are left out.

    Args:
        columns: Without a header in any of them the table has none.
        rows: What the cells are made from.
        width: Characters in a line: text is cut and columns are left out to fit; None for any number, without colours.
    """
    rows = list(rows)
    widths = {
        column: max(_cells(column.header), max((_cells(column.cell(row)) for row in rows), default=0))
        for column in columns
    }
    if width is not None:
        _fit(widths, width)
    if any(column.header for column in widths):
        header = _line(column.padded(column.header, cells) for column, cells in widths.items())
        yield header if width is None else click.style(header, bold=True)
    for row in rows:
        padded = {column: column.padded(column.cell(row), cells) for column, cells in widths.items()}
        yield _line(padded.values() if width is None else (each.coloured(row, padded[each]) for each in padded))
    left_out = [column.header for column in columns if column not in widths]
    if left_out:
        note = f"Too wide for this terminal: {', '.join(left_out)}."
        yield from (click.style(line, dim=True) for line in wrapped(note, width))


def _fit(widths: dict[Column, int], width: int) -> None:
    """Leave out columns, and narrow those of text, until a line fits."""
    whole = dict(widths)

    def room() -> int:
        return width - sum(widths.values()) - _GAP * (len(widths) - 1)

    if room() >= 0:
        return
    widths.update({column: min(whole[column], _LEAST_TEXT) for column in widths if column.text})
    ranked = [(column.dispensable, place) for place, column in enumerate(whole) if column.dispensable is not None]
    for _, place in sorted(ranked):
        if room() < 0:
            del widths[[*whole][place]]
    for column in widths:
        if column.text:
            widths[column] = max(0, min(whole[column], widths[column] + room()))


def _line(cells: Iterable[str]) -> str:
    return (" " * _GAP).join(cells).rstrip()


def _cells(text: str) -> int:
    """Return how many columns of a terminal a text takes."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len  # here, as it takes a while to import

    return cell_len(text)
