"""Solvers of the games of two seats: each plays either seat, by reading nothing but the observation.

They keep nothing between turns. What they leave to chance is decided by a hash of the episode's id in its run, what
they see, and a seed of their own: the same run gives the same games.
"""

from __future__ import annotations

import re
from fractions import Fraction
from itertools import product

from gem_core.env import stable_hash
from gem_core.errors import AgentError, ArgumentError
from gem_core.rollouts import Context
from gem_core.terminal import observation_text
from gem_core.types import Observation
from gem_games.agents import _wrong_game
from gem_games.kuhn_strategy import equilibrium
from gem_games.negotiation import POOL_VALUE, worth
from gem_games.tic_tac_toe import best_moves

_BOARD_ROW = re.compile(r"^ ([1-9XO]) \| ([1-9XO]) \| ([1-9XO])$", re.MULTILINE)
_MARK = re.compile(r"^You play ([XO])\.", re.MULTILINE)
_HAND = re.compile(
    r"^You are the (?:first|second) player and hold the (jack|queen|king)\. Moves so far: ([a-z, ]+)\.$", re.MULTILINE
)
_AMOUNTS = r"books (\d+), hats (\d+), balls (\d+)\.$"
_POOL = re.compile(f"^Pool: {_AMOUNTS}", re.MULTILINE)
_WORTH = re.compile(f"^Worth of one to you: {_AMOUNTS}", re.MULTILINE)
_OFFER = re.compile(r"^Proposal on the table: (?:the other player's; .*, worth (\d+) to you|.*)\.$", re.MULTILINE)
_TURNS = re.compile(r"^Turns left: (\d+) of (\d+),", re.MULTILINE)
_LEAST = {"fair": POOL_VALUE // 2, "greedy": POOL_VALUE * 4 // 5}
_HASHES = 1 << 53


class TicTacToeAgent:
    """Never loses TicTacToe; draws among the moves that are best against a perfect opponent.

    Args:
        seed: Other numbers give other draws.
    """

    def __init__(self, *, seed: int = 0) -> None:
        self.seed = seed

    def __call__(self, observation: Observation, context: Context) -> str:
        """Return one of the best moves.

        Raises:
            AgentError: The observation is not one of TicTacToe.
        """
        text = observation_text(observation)
        rows, marks = _BOARD_ROW.findall(text)[-3:], _MARK.findall(text)
        if len(rows) < 3 or not marks:
            raise _wrong_game("tictactoe", "game:TicTacToe-v0", context)
        board = "".join(map("".join, rows))
        moves = best_moves(board, marks[-1])
        return f"\\boxed{{{moves[_draw(self.seed, context, board) % len(moves)]}}}"


class KuhnAgent:
    """Plays KuhnPoker by an equilibrium: nobody wins more against it than the value of the game.

    Args:
        alpha: How often it bets with the jack in the first seat, from 0 to 1/3; a number, or text such as ``"1/3"``.
        seed: Other numbers give other draws.

    Raises:
        ArgumentError: ``alpha`` is out of range, or no number.
    """

    def __init__(self, alpha: float | str | Fraction = Fraction(1, 3), *, seed: int = 0) -> None:
        try:
            self.strategy = equilibrium(Fraction(alpha))
        except (ValueError, ZeroDivisionError, OverflowError, TypeError):
            raise ArgumentError(f"alpha must be a number from 0 to 1/3, as 0.2 or '1/3', not {alpha!r}") from None
        self.seed = seed

    def __call__(self, observation: Observation, context: Context) -> str:
        """Return a move.

        Raises:
            AgentError: The observation is not one of KuhnPoker.
        """
        hands = list(_HAND.finditer(observation_text(observation)))
        if not hands:
            raise _wrong_game("kuhn", "game:KuhnPoker-v0", context)
        card, played = hands[-1].groups()
        history = () if played == "none" else tuple(turn.split()[-1] for turn in played.split(", "))
        chip = self.strategy.get((card, history))
        if chip is None:
            raise AgentError(f"agent 'kuhn' has no move after {played!r}: the game is over")
        puts_in = _draw(self.seed, context, hands[-1][0]) < chip * _HASHES
        if history[-1:] == ("bet",):
            return "\\boxed{call}" if puts_in else "\\boxed{fold}"
        return "\\boxed{bet}" if puts_in else "\\boxed{check}"


class NegotiationAgent:
    """Negotiates by proposals, without a word: at first it wants all that is worth something to it, then less.

    It accepts what is worth as much to it as it wants now, and in the last turn anything above nothing. It proposes
    the most of the items to the other that leave it what it wants, and keeps none that is worth nothing to it.

    Args:
        style: ``"fair"``: what it wants goes down to half of the pool's value in the last turn. ``"greedy"``: to four
            fifths.

    Raises:
        ArgumentError: There is no such style.
    """

    def __init__(self, style: str = "fair") -> None:
        if style not in _LEAST:
            raise ArgumentError(f"style must be 'fair' or 'greedy', not {style!r}")
        self.least = _LEAST[style]

    def __call__(self, observation: Observation, context: Context | None = None) -> str:
        """Return a proposal, or accept the one on the table.

        Raises:
            AgentError: The observation is not one of Negotiation.
        """
        text = observation_text(observation)
        pools, worths, tables, turns = (list(line.finditer(text)) for line in (_POOL, _WORTH, _OFFER, _TURNS))
        if not (pools and worths and turns):
            raise _wrong_game("negotiator", "game:Negotiation-v0", context)
        pool, values = _numbers(pools[-1]), _numbers(worths[-1])
        left, most_turns = _numbers(turns[-1])
        wanted = POOL_VALUE - (POOL_VALUE - self.least) * (most_turns - left) / (most_turns - 1)
        offer = int(tables[-1][1] or 0) if tables else 0
        if offer and (offer >= wanted or left == 1):
            return "\\boxed{accept}"
        shares = [share for share in product(*(range(most + 1) for most in pool)) if worth(share, values) >= wanted]
        share = min(shares, key=lambda share: (sum(share), -worth(share, values)))
        return f"\\boxed{{propose {' '.join(map(str, share))}}}"


def _numbers(match: re.Match[str]) -> tuple[int, ...]:
    return tuple(map(int, match.groups()))


def _draw(seed: int, context: Context, seen: str) -> int:
    """Return a number below ``_HASHES``, the same for an episode of a run and what is seen in it."""
    return stable_hash(seed, context.env_id, context.episode, seen)
