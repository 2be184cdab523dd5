"""Lays words out as a crossword: all connected, and no letters side by side but those of a word."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

from gem_games.cheap_random import CheapRandom

_WIDTH = 1 << 12  # cells in a row of the sheet that words are laid out on: more than any layout needs
_MIDDLE = (_WIDTH // 2) * _WIDTH + _WIDTH // 2
_ACROSS, _DOWN = 1, _WIDTH
_TRIES_PER_WORD = 20  # words drawn before the layout is begun anew
_ROOM_FOR_A_WORD = 4  # new cells that are kept free for each word that is still to come


Begun = tuple[int, int, str]
"""The first cell of a word, its stride from cell to cell, and the word."""


class Placed(NamedTuple):
    """A word in its place.

    Args:
        row: Row of its first letter, from 0.
        column: Column of its first letter, from 0.
        across: Whether it runs across; otherwise it runs down.
        word: The word.
    """

    row: int
    column: int
    across: bool
    word: str


def lay_out(words: Sequence[str], count: int, most_cells: int, draws: CheapRandom) -> list[Placed]:
    """Choose words and place them, each one crossing another.

    Args:
        words: Words to choose from, enough of which have 5 letters or fewer.
        count: Words to place.
        most_cells: Cells that all words may take together, at least ``5 * count``.
        draws: What chances are drawn from.

    Returns:
        The words by row, then by column, moved as far to the top and to the left as they go.
    """
    while (begun := _try_to_lay_out(words, count, most_cells, draws)) is None:
        pass
    return _trimmed(begun)


def _try_to_lay_out(words: Sequence[str], count: int, most_cells: int, draws: CheapRandom) -> list[Begun] | None:
    """Place one word after another; None where nothing seems to fit, as around two short words that cross."""
    sheet: dict[int, str] = {}
    begun: list[Begun] = []
    taken: set[str] = set()
    for _ in range(_TRIES_PER_WORD * count):
        word = words[draws.below(len(words))]
        room = most_cells - len(sheet) - _ROOM_FOR_A_WORD * (count - len(begun) - 1)
        if word in taken or len(word) - bool(begun) > room:
            continue
        if begun:
            place = _place(word, sheet, begun, draws)
            if place is None:
                continue
        else:
            place = _MIDDLE, _ACROSS if draws.below(2) else _DOWN
        start, stride = place
        sheet.update(zip(range(start, start + stride * len(word), stride), word, strict=True))
        begun.append((start, stride, word))
        taken.add(word)
        if len(begun) == count:
            return begun
    return None


def _place(word: str, sheet: dict[int, str], begun: list[Begun], draws: CheapRandom) -> tuple[int, int] | None:
    """Draw one of the places where a word crosses another and breaks no rule: its first cell and its stride."""
    crossings = [
        (start + stride * theirs, stride, ours)
        for start, stride, other in begun
        for places in (_places(other),)
        for ours, letter in enumerate(word)
        if letter in places
        for theirs in places[letter]
    ]
    if not crossings:
        return None
    first = draws.below(len(crossings))
    for cell, theirs, ours in crossings[first:] + crossings[:first]:
        stride = theirs ^ _ACROSS ^ _DOWN
        if _fits(word, cell - stride * ours, stride, sheet):
            return cell - stride * ours, stride
    return None


def _fits(word: str, start: int, stride: int, sheet: dict[int, str]) -> bool:
    """Whether a word touches others only where it crosses them, with the same letter."""
    if start - stride in sheet or start + stride * len(word) in sheet:
        return False
    aside = stride ^ _ACROSS ^ _DOWN
    crossed = False
    cell = start
    for letter in word:
        if cell in sheet:
            # Two letters in a row that are there already belong to a word in the same direction.
            if crossed or sheet[cell] != letter:
                return False
            crossed = True
        elif cell - aside in sheet or cell + aside in sheet:
            return False
        else:
            crossed = False
        cell += stride
    return True


@cache
def _places(word: str) -> dict[str, list[int]]:
    """Return the places of each letter of a word."""
    return {letter: [place for place, each in enumerate(word) if each == letter] for letter in word}


def _trimmed(begun: list[Begun]) -> list[Placed]:
    top = min(start // _WIDTH for start, _, _ in begun)
    left = min(start % _WIDTH for start, _, _ in begun)
    return sorted(
        Placed(start // _WIDTH - top, start % _WIDTH - left, stride == _ACROSS, word) for start, stride, word in begun
    )
