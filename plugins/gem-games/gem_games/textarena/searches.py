"""Searches of TextArena that take too long, done faster with the same results: a seed deals the same game."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

_ALL_NUMBERS = 0b1111111110
_BOX = [row // 3 * 3 + column // 3 for row in range(9) for column in range(9)]
_ROWS = _COLUMNS = 6
_EXIT_COLUMN = 4
_MOST_POSITIONS = 1_000


def count_solutions(_: Any, grid: list[list[int]], solutions: list[Any], limit: int = 2) -> int:
    """Stand in for ``SudokuEnv._count_solutions``; what fills ``solutions`` is only counted by its caller."""
    rows, columns, boxes = [0] * 9, [0] * 9, [0] * 9
    empty = []
    for cell in range(81):
        row, column = divmod(cell, 9)
        number = grid[row][column]
        if number:
            rows[row] |= 1 << number
            columns[column] |= 1 << number
            boxes[_BOX[cell]] |= 1 << number
        else:
            empty.append(cell)
    solutions.extend([None] * _fillings(empty, rows, columns, boxes, limit))
    return len(solutions)


def _fillings(empty: list[int], rows: list[int], columns: list[int], boxes: list[int], limit: int) -> int:
    """Count the ways to fill the empty cells, up to a limit; the cell with the fewest numbers comes first."""
    if not empty:
        return 1
    fewest, best, best_open = 10, -1, 0
    for cell in empty:
        open_numbers = _ALL_NUMBERS & ~(rows[cell // 9] | columns[cell % 9] | boxes[_BOX[cell]])
        count = open_numbers.bit_count()
        if count < fewest:
            fewest, best, best_open = count, cell, open_numbers
            if count < 2:
                break
    row, column, box = best // 9, best % 9, _BOX[best]
    rest = [cell for cell in empty if cell != best]
    found = 0
    while best_open and found < limit:
        bit = best_open & -best_open
        best_open ^= bit
        rows[row] ^= bit
        columns[column] ^= bit
        boxes[box] ^= bit
        found += _fillings(rest, rows, columns, boxes, limit - found)
        rows[row] ^= bit
        columns[column] ^= bit
        boxes[box] ^= bit
    return found


def is_solvable(_: Any, vehicles: list[Any]) -> bool:
    """Stand in for ``RushHourEnv._is_solvable``: like it, visit 1,000 positions at most, the nearest first."""
    cars = tuple((v.row if v.horizontal else v.col, v.length, v.horizontal) for v in vehicles)
    start = tuple(v.col if v.horizontal else v.row for v in vehicles)
    red = next(number for number, v in enumerate(vehicles) if v.vid == "X")
    return _gets_out(cars, start, red)


@lru_cache(maxsize=256)  # a saved state is restored by playing the episode again
def _gets_out(cars: tuple[tuple[int, int, bool], ...], start: tuple[int, ...], red: int) -> bool:
    if start[red] >= _EXIT_COLUMN:
        return True
    cells = [
        [sum(1 << _cell(line, place + part, horizontal) for part in range(length)) for place in range(_ROWS)]
        for line, length, horizontal in cars
    ]
    seen = {start}
    queue = deque([start])
    for _turn in range(_MOST_POSITIONS):
        if not queue:
            break
        places = queue.popleft()
        taken = 0
        for number, place in enumerate(places):
            taken |= cells[number][place]
        for number, (line, length, horizontal) in enumerate(cars):
            place = places[number]
            for step, front in ((1, place + length), (-1, place - 1)):
                if not 0 <= front < _ROWS or taken >> _cell(line, front, horizontal) & 1:
                    continue
                if number == red and place + step >= _EXIT_COLUMN:
                    return True
                after = (*places[:number], place + step, *places[number + 1 :])
                if after not in seen:
                    seen.add(after)
                    queue.append(after)
    return False


def _cell(line: int, place: int, horizontal: bool) -> int:
    return line * _COLUMNS + place if horizontal else place * _COLUMNS + line


def neighbour_map(words_of_same_len: list[str]) -> dict[str, tuple[str, ...]]:
    """Stand in for ``WordLadderEnv._build_neighbor_map``: which words differ in one letter."""
    return _neighbours(tuple(words_of_same_len))


@lru_cache(maxsize=32)
def _neighbours(words: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    known = set(words)
    alphabet = "abcdefghijklmnopqrstuvwxyz"
    return {
        word: tuple(
            other
            for place, old in enumerate(word)
            for letter in alphabet
            if letter != old and (other := word[:place] + letter + word[place + 1 :]) in known
        )
        for word in words
    }


class _Pairs(Sequence[tuple[str, str, None]]):
    """Pairs of words, in a fraction of the memory that a list of 300,000 tuples takes."""

    def __init__(self, starts: list[str], targets: list[str]) -> None:
        self._starts, self._targets = starts, targets

    def __len__(self) -> int:
        return len(self._starts)

    def __getitem__(self, place: Any) -> Any:
        return self._starts[place], self._targets[place], None


def word_pairs(_: Any, neighbours: dict[str, tuple[str, ...]], min_steps: int, max_steps: int) -> _Pairs:
    """Stand in for ``WordLadderEnv._find_valid_pairs``: words that are so many steps apart; ways are left out."""
    return _pairs(tuple(neighbours), min_steps, max_steps)


@lru_cache(maxsize=32)
def _pairs(words: tuple[str, ...], min_steps: int, max_steps: int) -> _Pairs:
    neighbours = _neighbours(words)
    starts: list[str] = []
    targets: list[str] = []
    for start in neighbours:
        seen, ring = {start}, [start]
        for steps in range(1, max_steps + 1):
            ring = list(dict.fromkeys(other for word in ring for other in neighbours[word] if other not in seen))
            seen.update(ring)
            if steps >= min_steps:
                starts.extend([start] * len(ring))
                targets.extend(ring)
    return _Pairs(starts, targets)
