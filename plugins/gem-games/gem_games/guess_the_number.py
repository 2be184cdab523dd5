r"""GuessTheNumber: find a hidden number; after each guess comes 'higher' or 'lower'."""

from __future__ import annotations

import math

from gem_core.errors import ArgumentError
from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_whole, painted, quote, whole_number

_FARTHEST = 10**15


class GuessTheNumberEnv(Game):
    r"""Find a number by guesses such as ``\boxed{25}``.

    - Right: reward 1, the game is won.
    - Wrong: reward 0, and the hint whether the number is higher or lower.
    - Outside the range, or guessed before: reward 0, and no hint.
    - In the last turn, whichever of these it is: ``1 - |guess - number| / (max - min)``, or 0 outside the range.
    - Not a whole number: reward -0.1, the game is over.

    A whole number has ASCII digits, leading zeros or not, and a sign or not. A guess of 0 or below is one outside the
    range, unlike in gem-llm, which takes 0 for a format error; so is one of thousands of digits.

    Args:
        min_number: Lowest number. None draws it from 1 to 10, or 5 to 50 below the highest that was given.
        max_number: Highest number. None draws it 5 to 50 above the lowest.
        max_turns: Guesses allowed. None gives the square root of the range, rounded up, and one more.
        format_error_ends: See ``Game``.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    unreadable = "is not a whole number."

    def __init__(
        self,
        min_number: int | None = 1,
        max_number: int | None = 50,
        max_turns: int | None = 10,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("min_number", min_number, -_FARTHEST, _FARTHEST)
        check_whole("max_number", max_number, -_FARTHEST, _FARTHEST)
        check_whole("max_turns", max_turns, 1, _FARTHEST)
        if min_number is not None and max_number is not None and min_number >= max_number:
            raise ArgumentError(f"min_number must be below max_number, not {min_number} with {max_number}")
        self._given = min_number, max_number, max_turns
        self.min_number, self.max_number, self.max_turns = min_number or 0, max_number or 0, max_turns or 0
        self.number = 0
        self.guesses: list[int] = []
        self._hints = ""

    def _deal(self, draws: CheapRandom) -> None:
        if None in self._given:
            self._draw_range(draws)
        self.number = self.min_number + draws.below(self.max_number - self.min_number + 1)
        self._begin()

    def _draw_range(self, draws: CheapRandom) -> None:
        lowest, highest, turns = self._given
        if lowest is None:
            lowest = draws.below(10) + 1 if highest is None else highest - 5 - draws.below(46)
        if highest is None:
            highest = lowest + 5 + draws.below(46)
        if turns is None:
            turns = math.ceil(math.sqrt(highest - lowest)) + 1
        self.min_number, self.max_number, self.max_turns = lowest, highest, turns

    def _begin(self) -> None:
        self.guesses = []
        self._hints = ""

    def _rules(self) -> str:
        return (
            "Guess the Number: find a hidden whole number.\n"
            "After each guess you are told whether the number is higher or lower. A guess outside the range, or one "
            "that you have made before, costs a turn and gives no hint.\n"
            f"Write your guess inside \\boxed{{}}, for example \\boxed{{{self.min_number}}}.\n"
        )

    def _situation(self) -> str:
        return (
            f"\nThe number is from {self.min_number} to {self.max_number}. Hints so far: {self._hints or 'none'}.\n"
            + self._turns_left("Put your guess inside \\boxed{}.")
        )

    _read = staticmethod(whole_number)

    def _play(self, guess: int) -> StepResult:
        if not self.min_number <= guess <= self.max_number:
            return self._invalid(f"{quote(str(guess))} is outside the range.")
        closeness = 1 - abs(guess - self.number) / (self.max_number - self.min_number)
        if guess in self.guesses:
            return self._invalid(f"You have guessed {guess} before.", closeness)
        self.guesses.append(guess)
        if guess == self.number:
            return self._win(str(guess), f"{guess} is right: you found the number.")
        hint = f"{'higher' if guess < self.number else 'lower'} than {guess}"
        self._hints = f"{self._hints}, {hint}" if self._hints else hint
        return self._move(str(guess), f"The number is {hint}.", 0.0, closeness)

    def _solution(self) -> str:
        return f" The number was {self.number}."

    def _gold_answer(self) -> str | None:
        return str(self.number)

    def _random_answer(self) -> str:
        """Draw a number that has not been guessed, whatever the hints say."""
        while True:
            number = self.min_number + int(self.action_random.random() * (self.max_number - self.min_number + 1))
            # One is left while the game goes on, the right one; after the end there may be none.
            if number not in self.guesses or self.outcome != "playing":
                return str(number)

    def _drawing(self) -> str:
        width = 50
        share = width / (self.max_number - self.min_number + 1)
        low = max((guess + 1 for guess in self.guesses if guess < self.number), default=self.min_number)
        high = min((guess - 1 for guess in self.guesses if guess > self.number), default=self.max_number)
        first = int((low - self.min_number) * share)
        last = max(first + 1, int((high - self.min_number + 1) * share))
        closed = painted("·" * first, "dim"), painted("·" * (width - last), "dim")
        line = painted("█" * (last - first), "cyan").join(closed)
        guesses = ", ".join(map(str, self.guesses)) or "none"
        return f"{self.min_number} {line} {self.max_number}\nopen: {low} to {high} · guesses: {guesses}"
