r"""Strategies of KuhnPoker: the equilibria, and exact values as fractions.

A strategy says for each card and each history of moves how likely the seat is to put a chip in, that is to bet, or to
call a bet; it holds both seats' parts, 12 probabilities.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from itertools import permutations, product

from gem_core.errors import ArgumentError
from gem_games.kuhn_poker import CARDS, chips_won, legal_moves

History = tuple[str, ...]
Strategy = Mapping[tuple[str, History], Fraction]
"""Probability of a bet or a call by card and history."""

_FIRST: tuple[History, ...] = ((), ("check", "bet"))
_SECOND: tuple[History, ...] = (("check",), ("bet",))


def equilibrium(alpha: Fraction = Fraction(1, 3)) -> dict[tuple[str, History], Fraction]:
    """Return an equilibrium; against it no strategy of the other seat wins more than the value of the game.

    Args:
        alpha: How often the first seat bets with the jack, from 0 to 1/3; each gives an equilibrium. The second seat
            has one alone.

    Raises:
        ArgumentError: ``alpha`` is out of range.

    Source: H. W. Kuhn, A simplified two-person poker, Contributions to the Theory of Games I, 1950.
    """
    if not 0 <= alpha <= Fraction(1, 3):
        raise ArgumentError(f"alpha must be from 0 to 1/3, not {alpha}")
    never, third, always = Fraction(0), Fraction(1, 3), Fraction(1)
    chips = {
        (): (alpha, never, 3 * alpha),
        ("check", "bet"): (never, alpha + third, always),
        ("check",): (third, never, always),
        ("bet",): (never, third, always),
    }
    return {(card, history): chip for history, row in chips.items() for card, chip in zip(CARDS, row, strict=True)}


def expected_value(first: Strategy, second: Strategy) -> Fraction:
    """Return what the first seat wins in a game on average, in chips, over the six deals.

    Args:
        first: Strategy of the first seat.
        second: Strategy of the second seat.
    """
    deals = list(permutations(CARDS, 2))
    return sum((_value_of_deal(deal, (), (first, second)) for deal in deals), Fraction(0)) / len(deals)


def _value_of_deal(deal: tuple[str, ...], history: History, strategies: tuple[Strategy, Strategy]) -> Fraction:
    moves = legal_moves(history)
    if not moves:
        return Fraction(chips_won(deal[0], deal[1], history))
    seat = len(history) % 2
    chip = strategies[seat][deal[seat], history]
    shares = ((move, chip if move in ("bet", "call") else 1 - chip) for move in moves)
    return sum((share * _value_of_deal(deal, (*history, move), strategies) for move, share in shares), Fraction(0))


def best_response(strategy: Strategy) -> dict[tuple[str, History], Fraction]:
    """Return a strategy without chance that wins the most against another one, in each seat.

    Each is tried, 64 for a seat.
    """
    first = max(_pure(_FIRST), key=lambda own: expected_value(own, strategy))
    second = min(_pure(_SECOND), key=lambda own: expected_value(strategy, own))
    return {**first, **second}


def exploitability(strategy: Strategy) -> Fraction:
    """Return what a best response wins against a strategy in a game on average, in chips, over both seats.

    It is 0 for an equilibrium, and above 0 for every other strategy.
    """
    best = best_response(strategy)
    return (expected_value(best, strategy) - expected_value(strategy, best)) / 2


def _pure(histories: tuple[History, ...]) -> Iterator[dict[tuple[str, History], Fraction]]:
    places = list(product(CARDS, histories))
    for chips in product((Fraction(0), Fraction(1)), repeat=len(places)):
        yield dict(zip(places, chips, strict=True))
