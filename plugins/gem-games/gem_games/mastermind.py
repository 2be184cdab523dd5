r"""Mastermind: find a secret code; each guess is marked with black and white pegs."""

from __future__ import annotations

import math
from operator import eq

from gem_core.errors import ArgumentError
from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_flag, check_whole, painted, sizes_to_draw, whole_numbers

_SIZES = (2, 4, 10), (4, 6, 20), (4, 8, 30)
_LONGEST_CODE, _MOST_NUMBERS = 20, 100


class MastermindEnv(Game):
    r"""Find a code of numbers by guesses such as ``\boxed{1 2 3 4}``.

    A black peg stands for a right number in its right place, a white one for a right number in a wrong place.

    - A guess: ``(black pegs - most black pegs so far) / code length`` where that is positive, else 0. The rewards of a
      won game add up to 1.
    - A guess of the wrong length, with a number out of range, or made before: reward 0, and no pegs.
    - Repeated numbers are allowed in a guess, also where the code has none.
    - The last turn is rewarded like any other.
    - Not whole numbers with spaces between them: reward -0.1, the game is over.

    Args:
        code_length: Numbers in the code.
        num_numbers: The code consists of numbers from 1 to this.
        max_turns: Guesses allowed.
        duplicate_numbers: Whether the code may have a number twice.
        format_error_ends: See ``Game``.

    Where one of the first three is None, a size is drawn from (2, 4, 10), (4, 6, 20) and (4, 8, 30), and what was given
    replaces its part of it.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    unreadable = "is not a list of whole numbers with spaces between them."

    def __init__(
        self,
        code_length: int | None = 4,
        num_numbers: int | None = 6,
        max_turns: int | None = 20,
        duplicate_numbers: bool = False,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("code_length", code_length, 1, _LONGEST_CODE)
        check_whole("num_numbers", num_numbers, 1, _MOST_NUMBERS)
        check_whole("max_turns", max_turns, 1, 10**15)
        check_flag("duplicate_numbers", duplicate_numbers)
        self.duplicate_numbers = duplicate_numbers
        sizes = sizes_to_draw(_SIZES, (code_length, num_numbers, max_turns))
        self._sizes = [size for size in sizes if duplicate_numbers or size[0] <= size[1]]
        if not self._sizes:
            raise ArgumentError(
                f"a code of {sizes[0][0]} different numbers from 1 to {sizes[0][1]} cannot be; "
                "raise num_numbers, or allow duplicate_numbers"
            )
        self.code_length, self.num_numbers, self.max_turns = self._sizes[0]
        self.code: list[int] = []
        self._begin()

    def _deal(self, draws: CheapRandom) -> None:
        if len(self._sizes) > 1:
            self.code_length, self.num_numbers, self.max_turns = self._sizes[draws.below(len(self._sizes))]
        self.code = self._code(draws.below(self._num_codes()))
        self._begin()

    def _begin(self) -> None:
        self.best = 0
        self.guesses: dict[tuple[int, ...], str] = {}
        self._marked = ""

    def _num_codes(self) -> int:
        if self.duplicate_numbers:
            return int(self.num_numbers**self.code_length)
        return math.perm(self.num_numbers, self.code_length)

    def _code(self, index: int) -> list[int]:
        """Return the code of an index below ``_num_codes()``."""
        left = list(range(1, self.num_numbers + 1))
        code = []
        for _ in range(self.code_length):
            index, position = divmod(index, len(left))
            code.append(left[position] if self.duplicate_numbers else left.pop(position))
        return code

    def _rules(self) -> str:
        example = " ".join(map(str, self._code(0)))
        return (
            "Mastermind: find a secret code of numbers.\n"
            "Each guess is marked with pegs: black for a right number in its right place, white for a right number in "
            "a wrong place. A guess of another length, with a number out of range, or one that you have made before "
            "costs a turn and gets no pegs.\n"
            f"Write your guess inside \\boxed{{}} with spaces between the numbers, for example \\boxed{{{example}}}.\n"
        )

    def _situation(self) -> str:
        repeats = "with repeats possible" if self.duplicate_numbers else "all different"
        return (
            f"\nThe code: {self.code_length} numbers from 1 to {self.num_numbers}, {repeats}.\n"
            f"Guesses so far:{self._marked or ' none'}\n"
            + self._turns_left("Put your guess inside \\boxed{}, with spaces between the numbers.")
        )

    def _read(self, answer: str) -> list[int] | None:
        return whole_numbers(answer)

    def _play(self, numbers: list[int]) -> StepResult:
        if len(numbers) != self.code_length:
            return self._invalid(f"Your guess has length {len(numbers)}, and the code has length {self.code_length}.")
        guess = tuple(numbers)
        if min(guess) < 1 or max(guess) > self.num_numbers:
            return self._invalid(f"Your guess has a number that is not from 1 to {self.num_numbers}.")
        if guess in self.guesses:
            return self._invalid("You have made this guess before.")
        text = " ".join(map(str, guess))
        black = self._mark(guess, text)
        reward = max(0, black - self.best) / self.code_length
        self.best = max(self.best, black)
        if black == self.code_length:
            return self._win(text, f"{text} is right: you found the code.", reward)
        return self._move(text, f"Your guess {self.guesses[guess]}.", reward, reward)

    def _mark(self, guess: tuple[int, ...], text: str) -> int:
        """Note the pegs of a guess and return the number of black ones."""
        black, white = count_pegs(guess, self.code)
        self.guesses[guess] = marked = f"{text}: {black} black, {white} white"
        self._marked = f"{self._marked}\n{marked}"
        return black

    def _solution(self) -> str:
        return f" The code was {' '.join(map(str, self.code))}."

    def _gold_answer(self) -> str | None:
        return " ".join(map(str, self.code))

    def _random_answer(self) -> str:
        """Draw a code that was not guessed before."""
        while True:
            guess = self._code(int(self.action_random.random() * self._num_codes()))
            # One is left while the game goes on, the right one; after the end there may be none.
            if tuple(guess) not in self.guesses or self.outcome != "playing":
                return " ".join(map(str, guess))

    def _drawing(self) -> str:
        hidden = self.code if self.outcome in ("won", "lost") else ["?"] * self.code_length
        rows = [f"     {'  '.join(f'{number!s:>2}' for number in hidden)}"]
        for turn, guess in enumerate(self.guesses, start=1):
            black, white = count_pegs(guess, self.code)
            numbers = "  ".join(f"{number:>2}" for number in guess)
            rows.append(f"{turn:>3}. {numbers}   {painted('●' * black, 'green')}{painted('○' * white, 'yellow')}")
        return "\n".join(rows)


def count_pegs(guess: tuple[int, ...], code: list[int] | tuple[int, ...]) -> tuple[int, int]:
    """Return the black and white pegs of a guess."""
    black = sum(map(eq, guess, code))
    left = list(code)
    for number in guess:
        if number in left:
            left.remove(number)
    return black, len(code) - len(left) - black
