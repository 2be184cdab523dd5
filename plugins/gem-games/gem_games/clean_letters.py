"""Fills the free cells of a square of letters, so that nothing rude can be read in it by chance."""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gem_games.cheap_random import CheapRandom

# What nobody should meet in a grid made for a child. In ROT13, so that these lines can be shown to one as well.
_RUDE = codecs.decode(
    "nahf nefr nff ovgpu obbo ohz ohgg pyvg pbpx pbba penc phz phag qnza qvpx qlxr snt sneg spx shp shx tbbx ubzb wnc "
    "wvmm xvxr xvyy xxx yrfo yrm anmv arte avt ahqr betl cnxv crr cravf cvff cbb cbea cevpx chor chff encr frzra frk "
    "fuvg fynt fyhg fcvp fhpx gvg gheq gjng intva jnax jube jbt jbc jgs kkk",
    "rot13",
).upper()
_LONGEST = max(map(len, _RUDE.split()))
_BY_START: dict[str, list[str]] = {}
"""What is refused, forwards and backwards, by its first three letters."""
for _word in _RUDE.split():
    for _text in {_word, _word[::-1]}:
        _BY_START.setdefault(_text[:3], []).append(_text)


def _code(first: Any, second: Any, third: Any) -> Any:
    """Return a number for three letters, or for arrays of them; the last five bits tell capitals and a space apart."""
    return (first & 31) << 10 | (second & 31) << 5 | third & 31


_STARTS = np.zeros(1 << 15, dtype=bool)
_STARTS[[_code(*start.encode("ascii")) for start in _BY_START]] = True


def fill(placed: Sequence[dict[int, str]], letters: bytes, size: int, draws: CheapRandom) -> str | None:
    """Return the letters of a square, row by row: words in their places, and other letters around them.

    What stands within one of the words is let stand (as the middle of GRAPES, say).

    Args:
        placed: For each word, its cells, numbered row by row, with their letters as capitals.
        letters: As many capitals as the square has cells; those of cells without a word are shown.
        size: Rows, and columns.
        draws: What takes the place of a letter that would make something rude is drawn from it.

    Returns:
        None if it is the words themselves that make something rude where they cross or touch: place them anew.
    """
    taken: dict[int, str] = {}
    for cells in placed:
        taken.update(cells)
    grid = np.frombuffer(letters + b" ", dtype=np.uint8).astype(np.uint16)  # the space stands between two lines
    grid[list(taken)] = list(map(ord, taken.values()))
    while True:
        spelt = [cells for cells in _rude_cells(grid, size) if not any(word.keys() >= cells for word in placed)]
        if not spelt:
            return grid[:-1].astype(np.uint8).tobytes().decode("ascii")
        free = sorted(spelt[0] - taken.keys())
        if not free:
            return None
        grid[free[draws.below(len(free))]] = ord("A") + draws.below(26)


def _rude_cells(grid: NDArray[np.uint16], size: int) -> list[set[int]]:
    """Return the cells of each rude thing that can be read, in any direction."""
    order = _lines(size)
    text = grid[order]
    # Three letters are looked up at once in all places, which leaves a handful of them.
    starts = np.flatnonzero(_STARTS[_code(text[:-2], text[1:-1], text[2:])]).tolist()
    found = []
    for start in starts:
        read = "".join(map(chr, text[start : start + _LONGEST].tolist()))
        found += [
            set(order[start : start + len(word)].tolist()) for word in _BY_START[read[:3]] if read.startswith(word)
        ]
    return found


@cache
def _lines(size: int) -> NDArray[np.intp]:
    """Return the cells of all rows, columns and diagonals one after another, -1 behind each."""
    span = range(size)
    rows = [[(row, column) for column in span] for row in span]
    columns = [[(row, column) for row in span] for column in span]
    falling = [[(row, row + shift) for row in span if 0 <= row + shift < size] for shift in range(1 - size, size)]
    rising = [[(row, shift - row) for row in span if 0 <= shift - row < size] for shift in range(2 * size - 1)]
    order: list[int] = []
    for line in (*rows, *columns, *falling, *rising):
        order += [row * size + column for row, column in line]
        order.append(-1)
    return np.array(order, dtype=np.intp)
