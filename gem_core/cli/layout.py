"""``Layout``: tables that fit a terminal; less important columns are left out first."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence

import click

_GAP = "  "

Style = Callable[[str], str]
"""Colours a cell that is already padded to its width."""


def output_width() -> int | None:
    """Return the width of standard output in characters; None where it is no terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def echo_line(text: str, *, err: bool = False) -> None:
    """Write a line; a terminal that is too narrow for it gets it wrapped between words."""
    if (sys.stderr if err else sys.stdout).isatty():
        indent = " " * (len(text) - len(text.lstrip(" ")))
        width = max(shutil.get_terminal_size().columns, len(indent) + 20)
        text = textwrap.fill(text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    click.echo(text, err=err)


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


class Layout:
    """How rows of cells are laid out.

    If there is room, each row is a line. Otherwise headers are wrapped, then columns are left out, and if even the rest
    does not fit, each row becomes a paragraph with all columns.

    Args:
        headers: Name of each column.
        rows: Rows by which the columns are measured; later ones may be wider.
        width: Characters in a line; None for any number.
        left: Columns that stand to the left; the others are figures.
        names: Number of columns, from the first, that name the row; they head its paragraph.
        dispensable: Columns in the order in which they are left out.
        tail: A last column that is cut at a word, so long as there is room for ``least_tail`` characters of it.
    """

    least_tail = 24

    def __init__(
        self,
        headers: Sequence[str],
        rows: Sequence[Sequence[str]],
        width: int | None,
        *,
        left: Iterable[int] = (0,),
        names: int = 1,
        dispensable: Sequence[int] = (),
        tail: int | None = None,
    ) -> None:
        self._headers, self._width, self._tail = headers, width, tail
        self._left, self._names = set(left), names
        self._cells = [max((len(row[place]) for row in rows), default=0) for place in range(len(headers))]
        self.columns = list(range(len(headers)))
        """Columns that are shown; none where each row is a paragraph."""
        self.left_out: list[str] = []
        """Headers of the columns that were left out."""
        self._widths = [max(cell, len(header)) for cell, header in zip(self._cells, headers, strict=True)]
        if not self._fits():
            self._widths = [
                max([cell, *map(len, header.split())]) for cell, header in zip(self._cells, headers, strict=True)
            ]
        for place in dispensable:
            if not self._fits():
                self.columns.remove(place)
                self.left_out.append(headers[place])
        if not self._fits():
            self.columns, self.left_out = [], []

    def _fits(self) -> bool:
        if self._width is None:
            return True
        used = [
            min(self._widths[place], self.least_tail) if place == self._tail else self._widths[place]
            for place in self.columns
        ]
        return sum(used) + len(_GAP) * (len(used) - 1) <= self._width

    def header(self) -> list[str]:
        """Return the lines of the header; none above paragraphs."""
        wrapped = {
            place: textwrap.wrap(self._headers[place], self._widths[place], break_long_words=False) or [""]
            for place in self.columns
        }
        depth = max(map(len, wrapped.values()), default=0)
        below = {place: [""] * (depth - len(lines)) + lines for place, lines in wrapped.items()}
        return [self._line({place: lines[number] for place, lines in below.items()}, {}) for number in range(depth)]

    def row(self, cells: Sequence[str], styles: Mapping[int, Style] | None = None) -> list[str]:
        """Return the lines of a row."""
        styles = styles or {}
        if self.columns:
            return [self._line({place: cells[place] for place in self.columns}, styles)]
        name = " ".join(styles.get(place, str)(cells[place]) for place in range(self._names))
        return [name, *self._paragraph(cells, styles)]

    def _paragraph(self, cells: Sequence[str], styles: Mapping[int, Style]) -> list[str]:
        """Return the lines of a paragraph: the name, then each value beside its header."""
        width = max((self._width or 0) - len(_GAP), 10)
        lines: list[str] = []
        taken = width
        for place in range(self._names, len(cells)):
            if not cells[place]:
                continue
            first, *more = textwrap.wrap(f"{self._headers[place]} {cells[place]}", width, break_on_hyphens=False)
            if not more:
                first = f"{self._headers[place]} {styles.get(place, str)(cells[place])}"
            plain = len(self._headers[place]) + 1 + len(cells[place])
            if lines and not more and taken + 2 + plain <= width:
                lines[-1] += f", {first}"
                taken += 2 + plain
            else:
                lines += [first, *more]
                taken = width if more else plain
        return [f"{_GAP}{line}" for line in lines]

    def _line(self, cells: Mapping[int, str], styles: Mapping[int, Style]) -> str:
        parts: list[str] = []
        for place, cell in cells.items():
            width = self._widths[place]
            if place == self._tail and self._width is not None:
                before = sum(self._widths[other] + len(_GAP) for other in self.columns if other != place)
                cell = cut_at_word(cell, self._width - before)
            padded = cell.ljust(width) if place in self._left else cell.rjust(width)
            if place == self.columns[-1]:
                padded = padded.rstrip()
            parts.append(styles[place](padded) if place in styles and cell else padded)
        return _GAP.join(parts).rstrip()
