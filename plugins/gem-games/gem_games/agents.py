"""Solvers: agents that win by reading nothing but the observation, which shows all that is needed.

They keep nothing between turns, so that one serves many episodes at once, and read a history of observations as well
as the latest one alone.
"""

from __future__ import annotations

import re
from functools import lru_cache
from itertools import permutations, product
from math import perm

from gem_core.errors import AgentError
from gem_core.rollouts import Context
from gem_core.terminal import observation_text
from gem_core.types import Observation
from gem_games.mastermind import count_pegs
from gem_games.tower_of_hanoi import best_move

_RANGE = re.compile(r"The number is from (-?\d+) to (-?\d+)\.", re.ASCII)
_HINT = re.compile(r"(higher|lower) than (-?\d+)", re.ASCII)
_CODE = re.compile(r"The code: (\d+) numbers from 1 to (\d+), (all different|with repeats possible)\.", re.ASCII)
_MARKED = re.compile(r"(\d+(?: \d+)*): (\d+) black, (\d+) white", re.ASCII)
_PEG = re.compile(r"^([ABC]): (\d+(?: \d+)*|empty)$", re.ASCII | re.MULTILINE)
_MOST_CODES = 100_000

Code = tuple[int, ...]
Marked = tuple[Code, int, int]
"""A guess, its black pegs and its white pegs."""


class BisectionAgent:
    """Wins GuessTheNumber by halving what the hints leave open."""

    def __call__(self, observation: Observation, context: Context | None = None) -> str:
        """Return the middle of the numbers that are left.

        Raises:
            AgentError: The observation is not one of GuessTheNumber.
        """
        text = observation_text(observation)
        ranges = _RANGE.findall(text)
        if not ranges:
            raise _wrong_game("bisect", "game:GuessTheNumber-*", context)
        low, high = map(int, ranges[-1])
        for side, number in _HINT.findall(text):
            if side == "higher":
                low = max(low, int(number) + 1)
            else:
                high = min(high, int(number) - 1)
        return f"\\boxed{{{(low + high) // 2}}}"


class MastermindAgent:
    """Wins Mastermind by guessing the first code that agrees with all pegs so far."""

    def __call__(self, observation: Observation, context: Context | None = None) -> str:
        """Return a code that can still be the secret one.

        Raises:
            AgentError: The observation is not one of Mastermind, or there are too many codes to go through.
        """
        text = observation_text(observation)
        codes = _CODE.findall(text)
        if not codes:
            raise _wrong_game("mastermind", "game:Mastermind-*", context)
        length, numbers, repeats = int(codes[-1][0]), int(codes[-1][1]), codes[-1][2] == "with repeats possible"
        if (numbers**length if repeats else perm(numbers, length)) > _MOST_CODES:
            raise AgentError(f"agent 'mastermind' goes through at most {_MOST_CODES:,} codes; make the game smaller")
        marked = dict.fromkeys(
            (tuple(map(int, guess.split())), int(black), int(white)) for guess, black, white in _MARKED.findall(text)
        )
        possible = _possible(length, numbers, repeats, tuple(marked))
        if not possible:
            raise AgentError("agent 'mastermind' found no code that agrees with the pegs in the observation")
        return f"\\boxed{{{' '.join(map(str, possible[0]))}}}"


class HanoiAgent:
    """Solves TowerofHanoi in the fewest moves, from any position."""

    def __call__(self, observation: Observation, context: Context | None = None) -> str:
        """Return the best move.

        Raises:
            AgentError: The observation is not one of TowerofHanoi.
        """
        pegs = _PEG.findall(observation_text(observation))[-3:]
        if [name for name, _ in pegs] != ["A", "B", "C"]:
            raise _wrong_game("hanoi", "game:TowerofHanoi-*", context)
        place = {int(disk): name for name, row in pegs if row != "empty" for disk in row.split()}
        return f"\\boxed{{{' '.join(best_move(place))}}}"


@lru_cache(maxsize=2_000)
def _possible(length: int, numbers: int, repeats: bool, marked: tuple[Marked, ...]) -> list[Code]:
    """Return the codes that agree with all marked guesses. Kept, since most games begin alike."""
    if not marked:
        digits = range(1, numbers + 1)
        return list(product(digits, repeat=length) if repeats else permutations(digits, length))
    guess, black, white = marked[-1]
    before = _possible(length, numbers, repeats, marked[:-1])
    return [code for code in before if count_pegs(guess, code) == (black, white)]


def _wrong_game(agent: str, ids: str, context: Context | None) -> AgentError:
    found = f"the observation of {context.env_id!r}" if context is not None else "this observation"
    return AgentError(f"agent {agent!r} plays {ids}, and {found} is not of that game; see 'gem list game'")
