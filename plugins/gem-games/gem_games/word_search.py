r"""WordSearch: find words in a grid of letters, across or down."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.clean_letters import fill
from gem_games.game import Game, check_flag, check_whole, whole_numbers
from gem_games.letter_grid import coloured_grid, column_numbers, numbered_row
from gem_games.words import word_list

_NUM_WORDS, _MAX_TURNS = 5, 20
_MOST_WORDS = 30
_EASY_LENGTHS, _HARD_LENGTHS = range(4, 8), range(6, 12)
_TRIES = 100  # places tried for a word before the grid is made larger

Line = tuple[int, int, int, int]
"""Row and column of one end, row and column of the other."""


class WordSearchEnv(Game):
    r"""Show where words stand, as in ``\boxed{2 0 2 5}``: row and column of a word's first and of its last letter.

    Words run across, from left to right, or down; rows and columns are counted from 0. A word may also be given from
    its end to its beginning, and wherever the grid has it by chance, forwards or backwards.

    - A word that was not found before: ``1 / num_words``. All words found: the game is won.
    - Other letters, or a word that was found before: reward 0.
    - Outside the grid, neither in one row nor in one column, or given before in either order: reward 0.
    - The last turn is rewarded like any other.
    - Not four whole numbers with spaces between them: reward -0.1, the game is over.

    gem-llm does not say which words it has hidden, and counts no others; so a player who finds a word cannot know
    whether it is one of them. Here they are named, unless ``show_words`` is False. gem-llm may also fail to place a
    word, draws random actions that it cannot read itself, and lets chance spell what it will around the words: here
    nothing rude can be read in the grid, in any direction.

    Args:
        hardcore: Whether words are long and rare ones: 6 to 11 letters instead of 4 to 7 of common ones. None draws it.
        max_turns: Answers allowed. None stands for 20.
        num_words: Words that are hidden. None stands for 5.
        show_words: Whether an observation names the words.
        format_error_ends: See ``Game``.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    unreadable = "is not four whole numbers with spaces between them."

    def __init__(
        self,
        hardcore: bool | None = False,
        max_turns: int | None = 20,
        num_words: int | None = 5,
        *,
        show_words: bool = True,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("max_turns", max_turns, 1, 10**15)
        check_whole("num_words", num_words, 1, _MOST_WORDS)
        check_flag("hardcore", hardcore, or_drawn=True)
        check_flag("show_words", show_words)
        self.show_words = show_words
        self._given_hardcore = hardcore
        self.hardcore = bool(hardcore)
        self.max_turns, self.num_words = max_turns or _MAX_TURNS, num_words or _NUM_WORDS
        if self.max_turns < self.num_words:
            raise ArgumentError(
                f"max_turns must be at least num_words, not {self.max_turns} with {self.num_words}; "
                "each word takes a turn"
            )
        self.words: list[str] = []
        self.grid: list[str] = []
        self._begin()

    def _deal(self, draws: CheapRandom) -> None:
        if self._given_hardcore is None:
            self.hardcore = bool(draws.below(2))
        pool = _pool(self.hardcore)
        chosen: set[str] = set()
        while len(chosen) < self.num_words:
            word = pool[draws.below(len(pool))]
            # Of STOP and POTS, one would be found in the place of the other.
            if word[::-1] not in chosen:
                chosen.add(word)
        self.words = sorted(chosen, key=lambda word: (-len(word), word))
        self.grid = self._hide(draws)
        self.words.sort()
        self._begin()

    def _hide(self, draws: CheapRandom) -> list[str]:
        """Place the words, longest first, and fill what is left with random letters; return the rows."""
        size = max(math.ceil(1.5 * len(self.words[0])), math.isqrt(2 * sum(map(len, self.words))))
        text = None
        while text is None:
            while (placed := _place(self.words, size, draws)) is None:
                size += 1
            letters = self.np_random.integers(65, 91, size * size, dtype="uint8").tobytes()
            text = fill(placed, letters, size, draws)
        return [text[start : start + size] for start in range(0, size * size, size)]

    def _begin(self) -> None:
        self.found: dict[str, Line] = {}
        """The words that were found, and where."""
        self.tried: set[Line] = set()
        self._lines = [numbered_row(row, letters) for row, letters in enumerate(self.grid)]
        self._show_grid()

    def _show_grid(self) -> None:
        shown = [f"\nWords found: {len(self.found)} of {self.num_words}."]
        if self.show_words:
            left = ", ".join(word for word in self.words if word not in self.found)
            shown.append(f"Words to find: {left or 'none'}.")
        shown += [column_numbers(len(self.grid)), *self._lines]
        self._shown = "\n".join(shown)

    def _rules(self) -> str:
        return (
            f"Word Search: find {self.num_words} English words in a grid of letters.\n"
            "Words run across from left to right, or down. Rows and columns are counted from 0; the letters of words "
            "that you have found turn small. An answer outside the grid, one that is not in a single row or column, or "
            "one that you have given before costs a turn.\n"
            "Write inside \\boxed{} the row and column of a word's first letter, then the row and column of its last "
            "letter, for example \\boxed{2 0 2 5}.\n"
        )

    def _situation(self) -> str:
        return f"{self._shown}\n" + self._turns_left("Answer like \\boxed{2 0 2 5}: row column row column.")

    def _read(self, answer: str) -> list[int] | None:
        numbers = whole_numbers(answer)
        return numbers if numbers is not None and len(numbers) == 4 else None

    def _play(self, numbers: list[int]) -> StepResult:
        row, column, end_row, end_column = numbers
        size = len(self.grid)
        if not (0 <= row < size and 0 <= column < size and 0 <= end_row < size and 0 <= end_column < size):
            return self._invalid("That is outside the grid.")
        if row != end_row and column != end_column:
            return self._invalid("That is neither in one row nor in one column.")
        line = row, column, end_row, end_column
        if line in self.tried:
            return self._invalid("You have given that answer before.")
        self._try(line)
        word = self._word_at(line)
        text = f"{row} {column} {end_row} {end_column}"
        if word is None:
            return self._move(text, f"The letters {self._letters_on(line)} are none of the words.", 0.0, 0.0)
        if word in self.found:
            return self._move(text, f"{word} was found before.", 0.0, 0.0)
        self._find(word, line)
        self._show_grid()
        reward = 1 / self.num_words
        if len(self.found) == self.num_words:
            return self._win(text, f"You found {word}, the last of the words.", reward)
        return self._move(text, f"You found {word}.", reward, reward)

    def _try(self, line: Line) -> None:
        self.tried.add(line)
        self.tried.add((line[2], line[3], line[0], line[1]))

    def _letters_on(self, line: Line) -> str:
        """Return the letters from one end of a line to the other."""
        row, column, end_row, end_column = line
        if row == end_row:
            letters = self.grid[row][min(column, end_column) : max(column, end_column) + 1]
        else:
            letters = "".join(self.grid[each][column] for each in range(min(row, end_row), max(row, end_row) + 1))
        return letters[::-1] if (end_row, end_column) < (row, column) else letters

    def _word_at(self, line: Line) -> str | None:
        """Return the word that stands on a line, from either end; None if none does."""
        letters = self._letters_on(line)
        if letters in self.words:
            return letters
        return letters[::-1] if letters[::-1] in self.words else None

    def _find(self, word: str, line: Line) -> None:
        """Note a word and write its letters small, so that they are seen to be used."""
        self.found[word] = line
        for row, column in _cells(line):
            at = len(f"{row:>2}  ") + 3 * column
            text = self._lines[row]
            self._lines[row] = text[:at] + text[at].lower() + text[at + 1 :]

    def _solution(self) -> str:
        left = ", ".join(word for word in self.words if word not in self.found)
        return f" The words not found were {left}."

    def _gold_answer(self) -> str | None:
        word = next(word for word in self.words if word not in self.found)
        down = ["".join(column) for column in zip(*self.grid, strict=True)]
        for number, (across, upright) in enumerate(zip(self.grid, down, strict=True)):
            if word in across:
                first = across.index(word)
                return f"{number} {first} {number} {first + len(word) - 1}"
            if word in upright:
                first = upright.index(word)
                return f"{first} {number} {first + len(word) - 1} {number}"
        return None

    def _random_answer(self) -> str:
        """Draw a part of a row or a column that was not given before."""
        size = len(self.grid)
        random = self.action_random.random
        while True:
            fixed, first, last = (int(random() * size) for _ in range(3))
            line = (fixed, first, fixed, last) if random() < 0.5 else (first, fixed, last, fixed)
            # One is left while the game goes on: that of a word that was not found.
            if line not in self.tried or self.outcome != "playing":
                return " ".join(map(str, line))

    def _drawing(self) -> str:
        used = {cell for line in self.found.values() for cell in _cells(line)}
        size = range(len(self.grid))
        colours = [["green" if (row, column) in used else "" for column in size] for row in size]
        drawn = coloured_grid(self.grid, colours)
        named = self.show_words or self.outcome != "playing"
        words = (word.lower() if word in self.found else word if named else "?" for word in self.words)
        return f"{drawn}\n{' '.join(words)}"


@cache
def _pool(hardcore: bool) -> tuple[str, ...]:
    """Return the words that may be hidden, as capitals."""
    if hardcore:
        return tuple(word.upper() for length in _HARD_LENGTHS for word in word_list(length).every)
    return tuple(word.upper() for length in _EASY_LENGTHS for word in word_list(length).common)


def _place(words: list[str], size: int, draws: CheapRandom) -> list[dict[int, str]] | None:
    """Place words at random in a square of cells numbered row by row, each by itself; None if one finds no place."""
    placed: list[dict[int, str]] = []
    taken: dict[int, str] = {}
    for word in words:
        last = size - len(word) + 1
        for _ in range(_TRIES):
            draw = draws.below(2 * size * last)
            line, start = divmod(draw >> 1, last)
            across = draw & 1
            first, stride = (line * size + start, 1) if across else (start * size + line, size)
            cells = dict(zip(range(first, first + stride * len(word), stride), word, strict=True))
            if all(taken.get(cell, letter) == letter for cell, letter in cells.items()):
                break
        else:
            return None
        placed.append(cells)
        taken.update(cells)
    return placed


def _cells(line: Line) -> list[tuple[int, int]]:
    row, column, end_row, end_column = line
    return [
        (each_row, each_column)
        for each_row in range(min(row, end_row), max(row, end_row) + 1)
        for each_column in range(min(column, end_column), max(column, end_column) + 1)
    ]


def _line(numbers: list[Any]) -> Line:
    row, column, end_row, end_column = map(int, numbers)
    return row, column, end_row, end_column
