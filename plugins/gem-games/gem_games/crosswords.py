r"""Crosswords: fill crossing words into a grid, letter by letter, from their clues."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

from gem_core.errors import ArgumentError
from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.crossword_layout import Placed, lay_out
from gem_games.game import Game, check_flag, check_whole, whole_number
from gem_games.letter_grid import coloured_grid, column_numbers, numbered_row

_NUM_WORDS, _MAX_TURNS = 3, 20
_MOST_WORDS = 20
_TURNS_PER_WORD = 5
_LONGEST_ANSWER = 1_000  # characters
_ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_CLUES = Path(__file__).with_name("data") / "clues"


class Clues(NamedTuple):
    """The words of one difficulty.

    Args:
        words: As capitals.
        of: The clue of each.
    """

    words: tuple[str, ...]
    of: dict[str, str]


class CrosswordsEnv(Game):
    r"""Fill a crossword by answers such as ``\boxed{0 3 e}``: row and column, counted from 0, and the letter there.

    - The right letter: ``1 / cells``. All cells filled: the game is won. The rewards of a won game add up to 1.
    - A wrong letter: reward 0, and the cell stays empty.
    - Outside the grid, a cell without a letter, a filled one, or a letter that was wrong there before: reward 0.
    - The last turn is rewarded like any other.
    - Not two whole numbers and a letter from a to z with spaces between them: reward -0.1, the game is over.

    There are never more cells than turns. In gem-llm there may be, its words may touch without crossing, its clues do
    not say where their words begin, and its random actions are ones that it cannot read itself.

    Args:
        hardcore: Whether words and clues are hard ones. None draws it.
        max_turns: Letters that may be tried, at least 5 for each word. None stands for 20.
        num_words: Words of the crossword. None stands for 3.
        format_error_ends: See ``Game``.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem. Words and clues were
    written for this project.
    """

    unreadable = "is not a row, a column and a letter with spaces between them."

    def __init__(
        self,
        hardcore: bool | None = False,
        max_turns: int | None = 100,
        num_words: int | None = 5,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("max_turns", max_turns, 1, 10**15)
        check_whole("num_words", num_words, 1, _MOST_WORDS)
        check_flag("hardcore", hardcore, or_drawn=True)
        self._given_hardcore = hardcore
        self.hardcore = bool(hardcore)
        self.max_turns, self.num_words = max_turns or _MAX_TURNS, num_words or _NUM_WORDS
        if self.max_turns < _TURNS_PER_WORD * self.num_words:
            raise ArgumentError(
                f"max_turns must be at least {_TURNS_PER_WORD * self.num_words} for {self.num_words} words, "
                f"not {self.max_turns}; each letter takes a turn"
            )
        self.placed: list[Placed] = []
        self._begin()

    def _deal(self, draws: CheapRandom) -> None:
        if self._given_hardcore is None:
            self.hardcore = bool(draws.below(2))
        self.placed = lay_out(clues(self.hardcore).words, self.num_words, self.max_turns, draws)
        self._begin()

    def _begin(self) -> None:
        self.solution: dict[tuple[int, int], str] = {}
        """The letter of each cell, by row and column."""
        for row, column, across, word in self.placed:
            for place, letter in enumerate(word):
                self.solution[(row, column + place) if across else (row + place, column)] = letter
        self.height = max([row + (1 if across else len(word)) for row, _, across, word in self.placed], default=0)
        self.width = max([column + (len(word) if across else 1) for _, column, across, word in self.placed], default=0)
        self.grid = [["."] * self.width for _ in range(self.height)]
        for row, column in self.solution:
            self.grid[row][column] = "_"
        self.empty = len(self.solution)
        """Cells that are still to be filled."""
        self.wrong: dict[str, None] = {}
        """Answers that were wrong, in their plain form and in order."""
        self._lines = [numbered_row(row, cells) for row, cells in enumerate(self.grid)]
        known = clues(self.hardcore).of
        listed = (
            f"\n{'across' if across else 'down'} from row {row} column {column}, {len(word)} letters: {known[word]}"
            for row, column, across, word in self.placed
        )
        self._clues = f"\nThe clues:{''.join(listed)}\nThe grid, '_' for an empty cell and '.' for none:\n"
        self._clues += column_numbers(self.width)

    def _rules(self) -> str:
        return (
            f"Crosswords: fill a grid of {self.num_words} crossing words from their clues, letter by letter.\n"
            "Rows and columns are counted from 0. A right letter stays in its cell, a wrong one does not. A cell that "
            "is outside the grid, takes no letter or is filled costs a turn, and so does a letter that was wrong there "
            "before.\n"
            "Write the row, the column and the letter inside \\boxed{}, for example \\boxed{0 3 E}.\n"
        )

    def _situation(self) -> str:
        wrong = f"\nWrong so far: {', '.join(self.wrong)}." if self.wrong else ""
        grid = "\n".join(self._lines)
        return f"{self._clues}\n{grid}{wrong}\n" + self._turns_left("Answer like \\boxed{0 3 E}: row column letter.")

    def _read(self, answer: str) -> tuple[int, int, str] | None:
        pieces = answer.split() if len(answer) <= _LONGEST_ANSWER else []
        if len(pieces) != 3 or len(pieces[2]) != 1:
            return None
        row, column, letter = whole_number(pieces[0]), whole_number(pieces[1]), pieces[2]
        if row is None or column is None or not (letter.isascii() and letter.isalpha()):
            return None
        return row, column, letter.upper()

    def _play(self, answer: tuple[int, int, str]) -> StepResult:
        row, column, letter = answer
        if not (0 <= row < self.height and 0 <= column < self.width):
            return self._invalid("That cell is outside the grid.")
        there = self.grid[row][column]
        if there == ".":
            return self._invalid(f"The cell in row {row}, column {column} takes no letter.")
        if there != "_":
            return self._invalid(f"The cell in row {row}, column {column} is filled already.")
        text = f"{row} {column} {letter}"
        if text in self.wrong:
            return self._invalid(f"{letter} was wrong in row {row}, column {column} before.")
        if letter != self.solution[row, column]:
            self.wrong[text] = None
            return self._move(text, f"{letter} is wrong in row {row}, column {column}.", 0.0, 0.0)
        self._fill(row, column)
        reward = 1 / len(self.solution)
        if not self.empty:
            return self._win(text, f"{letter} is right, and the crossword is full.", reward)
        return self._move(text, f"{letter} is right in row {row}, column {column}.", reward, reward)

    def _fill(self, row: int, column: int) -> None:
        self.grid[row][column] = self.solution[row, column]
        self._lines[row] = numbered_row(row, self.grid[row])
        self.empty -= 1

    def _solution(self) -> str:
        return f" The words were {', '.join(placed.word for placed in self.placed)}."

    def _gold_answer(self) -> str | None:
        row, column = next(cell for cell in self.solution if self.grid[cell[0]][cell[1]] == "_")
        return f"{row} {column} {self.solution[row, column]}"

    def _random_answer(self) -> str:
        """Draw a letter for an empty cell where it was not wrong before."""
        random = self.action_random.random
        cells = [cell for cell in self.solution if self.grid[cell[0]][cell[1]] == "_"] or list(self.solution)
        while True:
            row, column = cells[int(random() * len(cells))]
            answer = f"{row} {column} {_ALPHABET[int(random() * len(_ALPHABET))]}"
            if answer not in self.wrong:  # the right letters are not
                return answer

    def _drawing(self) -> str:
        over = self.outcome == "lost"
        rows, colours = [], []
        for row, cells in enumerate(self.grid):
            letters = (self.solution[row, at] if over and cell == "_" else cell for at, cell in enumerate(cells))
            rows.append([letter if letter != "." else " " for letter in letters])
            colours.append(["red" if over and cell == "_" else "green" if cell.isalpha() else "" for cell in cells])
        known = clues(self.hardcore).of
        listed = (
            f"{row:>2} {column:>2} {'→' if across else '↓'} {known[word]} ({len(word)})"
            for row, column, across, word in self.placed
        )
        return "\n".join([coloured_grid(rows, colours), "", *listed])


@cache
def clues(hardcore: bool) -> Clues:
    """Return the easy or the hard words with their clues. The file has a word and its clue on each line."""
    name = "hard.txt" if hardcore else "easy.txt"
    lines = (_CLUES / name).read_text(encoding="utf-8").splitlines()
    known = {word.upper(): clue for word, _, clue in (line.partition(": ") for line in lines)}
    return Clues(tuple(known), known)
