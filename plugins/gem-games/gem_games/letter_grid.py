"""A square or oblong of letters as text, its rows and columns numbered from 0."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from gem_games.game import painted


@cache
def column_numbers(count: int) -> str:
    """Return the line above the rows: the number of each column above its letters."""
    return "   " + " ".join(f"{column:>2}" for column in range(count))


def numbered_row(row: int, cells: Sequence[str]) -> str:
    """Return a row behind its number, each cell under the number of its column."""
    return f"{row:>2}  {'  '.join(cells)}"


def coloured_grid(rows: Sequence[Sequence[str]], colours: Sequence[Sequence[str]]) -> str:
    """Draw rows of letters with their numbers, each letter ``painted`` in a colour, or plain where that is ``""``."""
    lines = [painted(column_numbers(len(rows[0])), "dim")]
    for row, (cells, shades) in enumerate(zip(rows, colours, strict=True)):
        pairs = zip(cells, shades, strict=True)
        letters = "  ".join(painted(letter, shade) if shade else letter for letter, shade in pairs)
        lines.append(f"{painted(f'{row:>2}', 'dim')}  {letters}")
    return "\n".join(lines)
