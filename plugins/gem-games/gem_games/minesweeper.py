r"""Minesweeper: reveal all cells that hide no mine; a number tells how many mines lie around its cell."""

from __future__ import annotations

import re
from functools import lru_cache

from gem_core.errors import ArgumentError
from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_whole, painted, quote, whole_number

_SIDES = range(5, 9)
_MOST_ROWS = 30
_LONGEST_ANSWER = 1_000  # characters
_ACTION = re.compile(r"([a-z]+)\s++([+-]?[0-9]++)\s++([+-]?[0-9]++)", re.ASCII | re.IGNORECASE)
_HIDDEN, _FLAG, _MINE, _NOTHING = b".F*0"
_COLOURS = {
    "0": "dim",
    "1": "blue",
    "2": "green",
    "3": "red",
    "4": "magenta",
    "5": "yellow",
    "6": "cyan",
    "F": "yellow",
    "*": "red",
}


class MinesweeperEnv(Game):
    r"""Reveal the cells without mines by ``\boxed{reveal 3 2}``; ``\boxed{flag 3 2}`` puts a flag, or takes it away.

    Rows and columns count from 0. Revealing a cell with no mine around it reveals the cells around it too, and so on,
    but for those with flags. The mines are laid by the first reveal, and none of them in its cell or around it.

    - A reveal: the share of the cells without mines that it uncovers.
    - All cells without mines are revealed: the game is won; the rewards add up to 1.
    - A mine: reward 0, the game is lost.
    - A flag: reward 0.
    - A cell off the board, to reveal one that is revealed or has a flag, to flag one that is revealed, another word
      than reveal and flag: reward 0, nothing changes.
    - The last turn is rewarded like any other.
    - Not a word and two whole numbers with spaces between them: reward -0.1, the game is over.

    In gem-llm every mine must also have its flag before the game is won, and to reveal a mine that has a flag loses.

    Args:
        rows: Rows; None draws a square board with a side of 5 to 8.
        cols: Columns; None: as many as rows.
        num_mines: Mines; None: one for five cells. There must be room for them beside the nine cells of the first
            reveal.
        max_turns: Turns allowed; None: as many as cells.
        format_error_ends: See ``Game``.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    unreadable = "is not reveal or flag with a row and a column."

    def __init__(
        self,
        rows: int | None = 8,
        cols: int | None = 8,
        num_mines: int | None = 10,
        max_turns: int | None = 20,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("rows", rows, 1, _MOST_ROWS)
        check_whole("cols", cols, 1, _MOST_ROWS)
        check_whole("num_mines", num_mines, 1, _MOST_ROWS**2)
        check_whole("max_turns", max_turns, 1, 10**15)
        self._given = rows, cols, num_mines, max_turns
        for side in _SIDES:
            self._set_size(side)
            room = self.rows * self.cols - min(3, self.rows) * min(3, self.cols)
            if not 1 <= self.num_mines <= room:
                raise ArgumentError(
                    f"a board of {self.rows} by {self.cols} has room for 1 to {room} mines beside the first reveal, "
                    f"not {self.num_mines}; change rows, cols or num_mines"
                )
        self._clear()

    def _set_size(self, side: int) -> None:
        rows, cols, num_mines, max_turns = self._given
        self.rows = rows if rows is not None else cols if cols is not None else side
        self.cols = cols if cols is not None else self.rows
        cells = self.rows * self.cols
        self.num_mines = num_mines if num_mines is not None else cells // 5
        self.max_turns = max_turns if max_turns is not None else cells

    def _deal(self, draws: CheapRandom) -> None:
        if self._given[0] is None and self._given[1] is None:
            self._set_size(_SIDES[draws.below(len(_SIDES))])
        self._clear()

    def _clear(self) -> None:
        self.mines: frozenset[int] | None = None
        """The cells with mines, row by row; None before the first reveal."""
        self._numbers: list[int] = []
        self._left = self.rows * self.cols - self.num_mines
        # The board is kept as the text that is shown; a cell's character stands at its place in it.
        text, self._places, self._around = _layout(self.rows, self.cols)
        self._board = bytearray(text)

    def _lay_mines(self, first: int) -> None:
        """Draw where the mines are, none of them in the first cell or around it."""
        draws = CheapRandom(self.np_random_seed)
        safe = {first, *self._around[first]}
        cells = [cell for cell in range(self.rows * self.cols) if cell not in safe]
        self._set_mines(frozenset(cells.pop(draws.below(len(cells))) for _ in range(self.num_mines)))

    def _set_mines(self, mines: frozenset[int]) -> None:
        self.mines = mines
        self._numbers = numbers = [0] * (self.rows * self.cols)
        for mine in mines:
            for cell in self._around[mine]:
                numbers[cell] += 1

    def _rules(self) -> str:
        return (
            f"Minesweeper: reveal all cells that hide no mine; {self.num_mines} of the {self.rows * self.cols} cells "
            "hide one.\n"
            "A revealed cell shows how many mines lie in the up to eight cells around it, and where that is 0, these "
            "are revealed too. To reveal a mine loses the game. The first reveal is safe. A flag marks a cell that you "
            "take for a mine and keeps it from being revealed; to flag it again takes the flag away. Flags are not "
            "needed to win.\n"
            "Write reveal or flag, the row and the column inside \\boxed{}, for example \\boxed{reveal 0 1}.\n"
        )

    def _situation(self) -> str:
        return (
            f"\nThe board with {self.num_mines} mines (. hidden, F flag, * mine), rows and columns numbered from 0:\n"
            f"{self._board.decode('ascii')}"
            + self._turns_left("Answer like \\boxed{reveal 0 1} or \\boxed{flag 0 1}: row 0, column 1.")
        )

    def _read(self, answer: str) -> re.Match[str] | None:
        return _ACTION.fullmatch(answer) if len(answer) <= _LONGEST_ANSWER else None

    def _play(self, match: re.Match[str]) -> StepResult:
        word, row, column = match[1].lower(), whole_number(match[2]), whole_number(match[3])
        if row is None or column is None or not (0 <= row < self.rows and 0 <= column < self.cols):
            return self._invalid(f"There is no row {match[2]:.10} with a column {match[3]:.10} on the board.")
        if word == "reveal":
            return self._reveal(row * self.cols + column, f"reveal {row} {column}")
        if word == "flag":
            return self._flag(row * self.cols + column, f"flag {row} {column}")
        return self._invalid(f"You can reveal or flag a cell, not {quote(word)} it.")

    def _reveal(self, cell: int, played: str) -> StepResult:
        place = self._places[cell]
        if self._board[place] != _HIDDEN:
            fault = "has a flag" if self._board[place] == _FLAG else "is revealed already"
            return self._invalid(f"That cell {fault}.")
        if self.mines is None:
            self._lay_mines(cell)
        if self.mines and cell in self.mines:
            for mine in self.mines:
                self._board[self._places[mine]] = _MINE
            return self._end("lost", "You revealed a mine.", 0.0, played)
        count = self._uncover(cell)
        self._left -= count
        reward = count / (self.rows * self.cols - self.num_mines)
        feedback = f"You revealed {count} cell{'s' if count > 1 else ''}."
        if not self._left:
            return self._win(played, f"{feedback} No cell without a mine is left: well done.", reward)
        return self._move(played, feedback, reward, reward)

    def _uncover(self, cell: int) -> int:
        """Reveal a hidden cell without a mine, and what it brings along; return how many cells that were."""
        board, places, numbers, around = self._board, self._places, self._numbers, self._around
        board[places[cell]] = _NOTHING + numbers[cell]
        if numbers[cell]:
            return 1
        # A cell is shown when it is put on the list, so that none gets there twice.
        revealed = [cell]
        for centre in revealed:
            if not numbers[centre]:
                for beside in around[centre]:
                    if board[places[beside]] == _HIDDEN:
                        board[places[beside]] = _NOTHING + numbers[beside]
                        revealed.append(beside)
        return len(revealed)

    def _flag(self, cell: int, played: str) -> StepResult:
        place = self._places[cell]
        if self._board[place] == _HIDDEN:
            self._board[place] = _FLAG
            return self._move(played, "You put a flag there.", 0.0, 0.0)
        if self._board[place] == _FLAG:
            self._board[place] = _HIDDEN
            return self._move(played, "You took the flag away.", 0.0, 0.0)
        return self._invalid("That cell is revealed already.")

    def _random_answer(self) -> str:
        """Draw a hidden cell to reveal or to flag, or a flag to take away."""
        hidden, flags = self._cells_that_show(_HIDDEN), self._cells_that_show(_FLAG)
        cells = hidden + hidden + flags or [0]
        place = int(self.action_random.random() * len(cells))
        word = "reveal" if place < len(hidden) else "flag"
        return f"{word} {cells[place] // self.cols} {cells[place] % self.cols}"

    def _cells_that_show(self, character: int) -> list[int]:
        return [cell for cell, place in enumerate(self._places) if self._board[place] == character]

    @property
    def shown(self) -> str:
        """What each cell shows, row by row."""
        return "".join(chr(self._board[place]) for place in self._places)

    def _drawing(self) -> str:
        shown = [
            painted(f" {'·' if cell == '0' else '■' if cell == '.' else cell}", _COLOURS.get(cell, "bold"))
            for cell in self.shown
        ]
        header = "   " + "".join(f"{column:>2}"[-2:] for column in range(self.cols))
        rows = [f"{row:>2} {''.join(shown[row * self.cols : (row + 1) * self.cols])}" for row in range(self.rows)]
        return "\n".join([painted(header, "dim"), *rows])


@lru_cache(maxsize=64)
def _layout(rows: int, cols: int) -> tuple[bytes, list[int], list[list[int]]]:
    """Return the text of a hidden board, where in it each cell's character stands, and the cells around each cell."""
    lines = ["   " + "".join(f"{column:>3}" for column in range(cols))]
    lines += [f"{row:>3}" + "  ." * cols for row in range(rows)]
    width = 3 * cols + 4
    places = [width * (row + 1) + 3 * column + 5 for row in range(rows) for column in range(cols)]
    around = [
        [
            row * cols + column
            for row in range(max(0, middle - 1), min(rows, middle + 2))
            for column in range(max(0, centre - 1), min(cols, centre + 2))
            if (row, column) != (middle, centre)
        ]
        for middle in range(rows)
        for centre in range(cols)
    ]
    return ("\n".join(lines) + "\n").encode("ascii"), places, around
