r"""Sudoku: fill a grid so that each row, column and box has every number once."""

from __future__ import annotations

from functools import lru_cache

from gem_core.errors import ArgumentError
from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_whole, painted, sizes_to_draw, whole_numbers
from gem_games.sudoku_grids import FEWEST_CLUES, make_puzzle

_SIZES = (4, 7, 15), (9, 34, 50)
_EMPTY = ord(".")


class SudokuEnv(Game):
    r"""Fill the empty cells by ``\boxed{2 3 7}``: row 2, column 3, number 7. Rows and columns count from 1.

    - The right number: one part in as many as there were empty cells. The rewards of a won game add up to 1.
    - Another number: reward 0, and it is not written down.
    - A cell that is filled, a number or cell out of range: reward 0.
    - The last turn is rewarded like any other.
    - Not three whole numbers with spaces between them: reward -0.1, the game is over.

    Every puzzle has exactly one solution, which can be found without guessing.

    Args:
        clues: Cells that are filled at the beginning, at least 5 on a 4x4 grid and 31 on a 9x9 one. In gem-llm it is
            how many cells it tries to empty; its 10 and 50 leave about 7 and 34 filled, which are the numbers here.
        max_turns: Turns allowed; at least as many as there are empty cells.
        scale: 4 or 9: rows, columns, and numbers in each.
        format_error_ends: See ``Game``.

    Where one of the first three is None, a size is drawn from 4x4 with 7 clues and 15 turns, and 9x9 with 34 clues and
    50 turns, and what was given replaces its part of it; sizes that cannot be solved in time are left out.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    unreadable = "is not a row, a column and a number."

    def __init__(
        self,
        clues: int | None = 34,
        max_turns: int | None = 100,
        scale: int | None = 9,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("max_turns", max_turns, 1, 10**15)
        if scale is not None and (type(scale) is not int or scale not in FEWEST_CLUES):
            raise ArgumentError(f"scale must be 4 or 9, or None to draw it, not {scale!r}")
        if scale is not None:
            check_whole("clues", clues, FEWEST_CLUES[scale], scale**2 - 1)
        check_whole("clues", clues, min(FEWEST_CLUES.values()), max(FEWEST_CLUES) ** 2 - 1)
        self._sizes = [
            (side, filled, turns)
            for side, filled, turns in sizes_to_draw(_SIZES, (scale, clues, max_turns))
            if FEWEST_CLUES[side] <= filled < side**2 and side**2 - filled <= turns
        ]
        if not self._sizes:
            raise ArgumentError(
                f"scale={scale}, clues={clues} and max_turns={max_turns} leave more cells empty than there are turns; "
                "raise clues or max_turns"
            )
        self._set_size(*self._sizes[0])
        self.solution = [0] * self.scale**2
        self._put([0] * self.scale**2)

    def _set_size(self, scale: int, clues: int, max_turns: int) -> None:
        self.scale, self.clues, self.max_turns = scale, clues, max_turns
        self._worth = 1 / (scale**2 - clues)

    def _put(self, cells: list[int]) -> None:
        """Take over a grid; 0 stands for an empty cell."""
        self.cells = cells
        self._left = cells.count(0)
        # The grid is kept as the text that is shown; a cell's character stands at its place in it.
        text, self._places = _layout(self.scale)
        self._text = bytearray(text)
        for place, number in zip(self._places, cells, strict=True):
            if number:
                self._text[place] = ord("0") + number

    def _deal(self, draws: CheapRandom) -> None:
        if len(self._sizes) > 1:
            self._set_size(*self._sizes[draws.below(len(self._sizes))])
        cells, self.solution = make_puzzle(self.scale, self.clues, draws)
        self._put(cells)

    def _rules(self) -> str:
        side = int(self.scale**0.5)
        return (
            f"Sudoku: fill the {self.scale}x{self.scale} grid with numbers from 1 to {self.scale}, so that each row, "
            f"each column and each of the boxes of {side}x{side} cells has every number once. There is exactly one "
            "solution.\n"
            "Each turn you fill one empty cell. A wrong number is not written down and costs a turn.\n"
            "Write the row, the column and the number inside \\boxed{} with spaces between them, for example "
            "\\boxed{1 2 3} for a 3 in row 1, column 2.\n"
        )

    def _situation(self) -> str:
        return (
            f"\nThe grid (. is empty), rows and columns numbered from 1:\n{self._text.decode('ascii')}"
            f"Empty cells: {self._left}. " + self._turns_left("Answer like \\boxed{1 2 3}: row, column, number.")
        )

    def _read(self, answer: str) -> list[int] | None:
        numbers = whole_numbers(answer)
        return numbers if numbers is not None and len(numbers) == 3 else None

    def _play(self, numbers: list[int]) -> StepResult:
        row, column, number = numbers
        scale = self.scale
        if not (0 < row <= scale and 0 < column <= scale and 0 < number <= scale):
            return self._invalid(f"Rows, columns and numbers go from 1 to {scale}.")
        cell = (row - 1) * scale + column - 1
        if self.cells[cell]:
            return self._invalid(f"Row {row}, column {column} is filled already.")
        played = f"{row} {column} {number}"
        if self.solution[cell] != number:
            return self._move(played, f"{number} is wrong in row {row}, column {column}.", 0.0, 0.0)
        self.cells[cell] = number
        self._text[self._places[cell]] = ord("0") + number
        self._left -= 1
        feedback = f"{number} is right in row {row}, column {column}."
        if not self._left:
            return self._win(played, f"{feedback} The grid is full: well done.", self._worth)
        return self._move(played, feedback, self._worth, self._worth)

    def _gold_answer(self) -> str | None:
        cell = self.cells.index(0)
        return f"{cell // self.scale + 1} {cell % self.scale + 1} {self.solution[cell]}"

    def _random_answer(self) -> str:
        """Draw an empty cell and any number; the last cell, where none is empty."""
        empty = [cell for cell, number in enumerate(self.cells) if not number] or [self.scale**2 - 1]
        cell, number = divmod(int(self.action_random.random() * len(empty) * self.scale), self.scale)
        return f"{empty[cell] // self.scale + 1} {empty[cell] % self.scale + 1} {number + 1}"

    def _drawing(self) -> str:
        lines = self._text.decode("ascii").splitlines()
        header, rows = lines[0], lines[1:]
        bold = ["".join(painted(mark, "bold") if mark.isdigit() else mark for mark in row[1:]) for row in rows]
        marks = [painted(row[0], "dim") for row in rows]
        return "\n".join([painted(header, "dim"), *map(str.__add__, marks, bold)])


@lru_cache(maxsize=len(FEWEST_CLUES))
def _layout(scale: int) -> tuple[bytes, list[int]]:
    """Return the text of an empty grid, and where in it each cell's character stands."""
    side = int(scale**0.5)

    def row(first: str, marks: list[str]) -> str:
        boxes = [" ".join(marks[start : start + side]) for start in range(0, scale, side)]
        return f"{first} {' | '.join(boxes)}\n"

    header = row(" ", list(map(str, range(1, scale + 1)))).replace("|", " ")
    rule = f"  {'+-'.join(['-' * 2 * side] * side)}"[: len(header) - 1] + "\n"
    lines = [header]
    for number in range(1, scale + 1):
        if number > 1 and number % side == 1:
            lines.append(rule)
        lines.append(row(str(number), ["."] * scale))
    text = "".join(lines).encode("ascii")
    return text, [place for place, mark in enumerate(text) if mark == _EMPTY]
