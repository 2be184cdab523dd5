"""Sudoku grids: a full one is drawn, then cells are emptied that the others still force; so one solution remains."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from gem_games.cheap_random import CheapRandom

FEWEST_CLUES = {4: 5, 9: 31}
"""By scale: fewer clues than these take long to find, or leave more than one solution."""


class Units(NamedTuple):
    """The rows, columns and boxes of a grid, numbered in this order.

    Args:
        of: For each cell, its row, its column and its box.
        cells: For each unit, its cells.
    """

    of: list[tuple[int, int, int]]
    cells: list[list[int]]


@lru_cache(maxsize=4)
def units(scale: int) -> Units:
    """Return the units of a grid of a scale that is a square number."""
    side = int(scale**0.5)
    of = [
        (row, scale + column, 2 * scale + row // side * side + column // side)
        for row in range(scale)
        for column in range(scale)
    ]
    return Units(of, [[cell for cell in range(scale**2) if unit in of[cell]] for unit in range(3 * scale)])


def make_puzzle(scale: int, clues: int, draws: CheapRandom) -> tuple[list[int], list[int]]:
    """Return a puzzle and its only solution, row by row; 0 stands for an empty cell.

    Each cell is emptied only if the rest forces it at once: no other number fits there, or the number fits nowhere else
    in its row, column or box. Filling the cells in the opposite order is then a solution without a guess, and the only
    one.

    Args:
        scale: 4 or 9.
        clues: Cells that stay filled, from ``FEWEST_CLUES[scale]`` to one below all.
        draws: Where its randomness comes from.
    """
    while True:
        solution = _full_grid(scale, draws)
        puzzle = _emptied(solution, scale, clues, _shuffled(list(range(scale**2)), draws))
        if puzzle is not None:
            return puzzle, solution


def _full_grid(scale: int, draws: CheapRandom) -> list[int]:
    """Draw a full grid: the boxes of the diagonal, which share nothing, at random; then the rest by search."""
    of, cells = units(scale)
    side = int(scale**0.5)
    while True:
        grid, used = [0] * scale**2, [0] * (3 * scale)
        for box in range(0, scale, side + 1):
            numbers = _shuffled(list(range(1, scale + 1)), draws)
            for cell, number in zip(cells[2 * scale + box], numbers, strict=True):
                grid[cell] = number
                for unit in of[cell]:
                    used[unit] |= 1 << number
        left = [cell for cell in range(scale**2) if not grid[cell]]
        if _fill(grid, used, left, scale, draws):
            return grid


def _shuffled(items: list[int], draws: CheapRandom) -> list[int]:
    """Return a list in an order that is drawn, each as likely as the others; the list is used up."""
    return [items.pop(draws.below(left)) for left in range(len(items), 0, -1)]


def _fill(grid: list[int], used: list[int], left: list[int], scale: int, draws: CheapRandom) -> bool:
    """Fill the cells that are left, the one with the fewest numbers first; say whether that was possible.

    Args:
        grid: Filled in place.
        used: For each unit, a bit for each number in it.
        left: Empty cells.
        scale: Numbers in the grid.
        draws: Where the number that is tried first comes from.
    """
    if not left:
        return True
    of = units(scale).of
    every = (2 << scale) - 2
    fewest, best, best_open = scale + 1, left[0], 0
    for cell in left:
        row, column, box = of[cell]
        open_numbers = every & ~(used[row] | used[column] | used[box])
        count = open_numbers.bit_count()
        if count < fewest:
            fewest, best, best_open = count, cell, open_numbers
            if count < 2:
                break
    numbers = [number for number in range(1, scale + 1) if best_open >> number & 1]
    first = draws.below(len(numbers)) if len(numbers) > 1 else 0
    rest = [cell for cell in left if cell != best]
    for number in numbers[first:] + numbers[:first]:
        grid[best] = number
        for unit in of[best]:
            used[unit] |= 1 << number
        if _fill(grid, used, rest, scale, draws):
            return True
        for unit in of[best]:
            used[unit] ^= 1 << number
    grid[best] = 0
    return False


def _emptied(solution: list[int], scale: int, clues: int, order: list[int]) -> list[int] | None:
    """Return a grid with all but some clues emptied, tried in an order; None if that order leaves too many."""
    of, cells = units(scale)
    puzzle = solution.copy()
    every = (2 << scale) - 2
    used = [every] * (3 * scale)
    left = len(puzzle)
    for cell in order:
        if left == clues:
            break
        row, column, box = of[cell]
        bit = 1 << puzzle[cell]
        for unit in of[cell]:
            used[unit] ^= bit
        if every & ~(used[row] | used[column] | used[box]) == bit or any(
            _only_place(cell, bit, cells[unit], puzzle, used, of) for unit in of[cell]
        ):
            puzzle[cell] = 0
            left -= 1
        else:
            for unit in of[cell]:
                used[unit] |= bit
    return puzzle if left == clues else None


def _only_place(
    cell: int, bit: int, unit: list[int], puzzle: list[int], used: list[int], of: list[tuple[int, int, int]]
) -> bool:
    """Say whether no other empty cell of a unit can hold the number of a bit."""
    for other in unit:
        if not puzzle[other] and other != cell:
            row, column, box = of[other]
            if not (used[row] | used[column] | used[box]) & bit:
                return False
    return True
