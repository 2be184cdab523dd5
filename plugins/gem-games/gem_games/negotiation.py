r"""Negotiation: two seats with hidden values share out a pool of items, or do not; with the best deals there are."""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import NamedTuple

from gem_core.errors import ArgumentError
from gem_games.cheap_random import CheapRandom
from gem_games.game import painted, whole_numbers
from gem_games.joint_game import JointGame

ITEMS = "books", "hats", "balls"
POOL_VALUE = 10
"""What the whole pool is worth to each seat."""
LONGEST_MESSAGE = 500
"""Characters of a message that the other seat hears."""

_FEWEST_ITEMS, _MOST_ITEMS = 5, 7
_MOST_TURNS = 100
_SAY, _END_SAY = "<say>", "</say>"

Amounts = tuple[int, ...]
"""A number for each of ``ITEMS``."""


class NegotiationEnv(JointGame):
    r"""Share out books, hats and balls with another seat that values them differently.

    A seat says something to the other inside ``<say></say>``, and may put one of these inside ``\boxed{}``:

    - ``propose 1 2 0``: that it gets 1 book, 2 hats and no ball, and the other seat what is left. This takes the place
      of any proposal on the table.
    - ``accept``: takes the proposal of the other seat that is on the table, which is the deal.
    - ``leave``: ends the negotiation without a deal.

    Each seat is rewarded at the end by what its items are worth to it, divided by 10, so between 0 and 1. Without a
    deal, after ``max_turns`` turns, when a seat leaves, or gives three answers in a row that are not valid, both get 0.
    ``info["correct"]`` is whether a seat has got anything of worth, more than without a deal; how much, the reward
    says.

    The other seat hears the first 500 characters of what was said, on one line, and the move. What was said stands in
    the feedback of the next observation alone; the proposal on the table stands in each. At the end both learn what the
    deal is worth to the other.

    The pool has 5 to 7 items, at least one of each kind. Values are drawn so that the whole pool is worth 10 to each
    seat, each kind is worth something to one of them, and some kind to both.

    Args:
        max_turns: Turns of both seats in all, from 2 to 100.

    Raises:
        ArgumentError: ``max_turns`` is out of range.

    Source: the task of Lewis et al., Deal or no deal, arXiv:1706.05125. There a dialogue in words is followed by what
    both select; here a proposal is accepted, so that both mean the same.
    """

    possible_agents = ("first", "second")
    stake = 0
    forfeiting = "ends the negotiation without a deal"
    nothing_read = "Your response has neither <say></say> nor a complete \\boxed{}."
    unreadable = "is not a proposal such as 'propose 1 2 0', nor 'accept' or 'leave'."

    def __init__(self, max_turns: int = 10) -> None:
        super().__init__()
        if type(max_turns) is not int or not 2 <= max_turns <= _MOST_TURNS:
            raise ArgumentError(f"max_turns must be a whole number from 2 to {_MOST_TURNS}, not {max_turns!r}")
        self.max_turns = max_turns
        self.turn = 0
        self.pool: Amounts = ()
        self.values: dict[str, Amounts] = {}
        """What an item of each kind is worth, by seat."""
        self.table: dict[str, Amounts] = {}
        """What each seat would get by the proposal on the table; empty if there is none."""
        self.proposer = ""
        self.agreed = False
        self._message = ""

    def _deal(self, draws: CheapRandom) -> None:
        pools = _pools()
        self.pool = pools[draws.below(len(pools))]
        pairs = _values(self.pool)
        self.values = dict(zip(self.possible_agents, pairs[draws.below(len(pairs))], strict=True))
        self.turn, self.table, self.proposer, self.agreed = 0, {}, "", False

    def _rules(self, seat: str) -> str:
        return (
            "Negotiation: you and another player share out a pool of books, hats and balls. Each of you knows only "
            f"what the items are worth to itself; the whole pool is worth {POOL_VALUE} to either.\n"
            f"You take turns, {self.max_turns} in all. In a turn you may say something, and do one of these:\n"
            "- \\boxed{propose 1 2 0}: you would get 1 book, 2 hats and no ball, and the other player what is left. "
            "This takes the place of any proposal on the table.\n"
            "- \\boxed{accept}: you accept the other player's proposal on the table, and it is the deal.\n"
            "- \\boxed{leave}: you end the negotiation without a deal.\n"
            f"Write what you say inside {_SAY}{_END_SAY}; the other player hears that, up to {LONGEST_MESSAGE} "
            "characters, and what you do, and nothing else of your response.\n"
            f"With a deal, your reward is what your items are worth to you, divided by {POOL_VALUE}. Without one, both "
            "of you get 0; so it is after the last turn.\n"
        )

    def _situation(self, seat: str) -> str:
        if not self.table:
            table = "none"
        else:
            share = self.table[seat]
            by = "yours" if self.proposer == seat else "the other player's"
            table = f"{by}; you would get {_listed(share)}, worth {worth(share, self.values[seat])} to you"
        return (
            f"\nPool: {_listed(self.pool)}.\nWorth of one to you: {_listed(self.values[seat])}.\n"
            f"Proposal on the table: {table}.\n" + (self._ending(seat) if self.outcomes else self._todo(seat))
        )

    def _todo(self, seat: str) -> str:
        accept = ", \\boxed{accept}" if self.proposer == _other(seat) else ""
        return (
            f"Turns left: {self.max_turns - self.turn} of {self.max_turns}, this one included. "
            f"Answer with {_SAY}{_END_SAY}, and \\boxed{{propose 1 2 0}}{accept} or \\boxed{{leave}}."
        )

    def _ending(self, seat: str) -> str:
        if not self.agreed:
            return "The negotiation is over without a deal."
        mine, its = (worth(self.table[each], self.values[each]) for each in (seat, _other(seat)))
        return f"The negotiation is over: the deal is worth {mine} to you, and {its} to the other player."

    def _understand(self, seat: str, text: str) -> tuple[str, str]:
        self._message, rest = _split_message(text)
        if self._message and "\\boxed" not in rest:
            return "talk", ""
        return super()._understand(seat, rest)

    def _read(self, answer: str) -> str | None:
        word, _, amounts = answer.lower().partition(" ")
        if word in ("accept", "leave"):
            return None if amounts else word
        numbers = whole_numbers(amounts.replace(",", " ")) if word == "propose" else None
        return f"propose {' '.join(map(str, numbers))}" if numbers and len(numbers) == len(ITEMS) else None

    def _fault(self, seat: str, move: str) -> str:
        if move == "accept" and self.proposer != _other(seat):
            return "There is no proposal of the other player on the table."
        if move.startswith("propose") and not all(
            0 <= amount <= most for amount, most in zip(_amounts(move), self.pool, strict=True)
        ):
            return f"A proposal can give you no more than the pool has: {_listed(self.pool)}."
        return ""

    def _play(self, moves: dict[str, str]) -> tuple[dict[str, float], bool]:
        ((seat, move),) = moves.items()
        other = _other(seat)
        self.turn += 1
        if self._message:
            self._tell(other, f'The other player says: "{self._message}"')
        if move == "accept":
            self.agreed = True
            self._tell(seat, "You accept the proposal.")
            self._tell(other, "The other player accepts your proposal.")
            return {each: worth(self.table[each], self.values[each]) / POOL_VALUE for each in self.table}, True
        if move.startswith("propose"):
            share = _amounts(move)
            left = tuple(most - amount for most, amount in zip(self.pool, share, strict=True))
            self.table, self.proposer = {seat: share, other: left}, seat
            self._tell(other, f"The other player proposes to get {_listed(share)}.")
        if move == "leave":
            self._tell(seat, "You leave.")
            self._tell(other, "The other player leaves.")
            return {}, True
        if self.turn == self.max_turns:
            for each in self.possible_agents:
                self._tell(each, "That was the last turn.")
        return {}, self.turn == self.max_turns

    def _random_answer(self, seat: str) -> str:
        """Draw a move: most often a proposal, each as likely as the others."""
        kind = self.action_random.random()
        if kind < 0.05:
            return "leave"
        if kind < 0.4 and self.proposer == _other(seat):
            return "accept"
        return f"propose {' '.join(str(int(self.action_random.random() * (most + 1))) for most in self.pool)}"

    def _drawing(self) -> str:
        """Draw a table of items, in which values are shown at the end."""
        columns = {"pool": self.pool}
        if self.outcomes:
            columns |= {f"worth to {seat}": values for seat, values in self.values.items()}
        columns |= {f"for {seat}": share for seat, share in self.table.items()}
        heads = [painted(f"{head:>16}", "bold") for head in columns]
        rows = (
            f"{item:>8}" + "".join(f"{cells[row]:>16}" for cells in columns.values()) for row, item in enumerate(ITEMS)
        )
        return "\n".join([" " * 8 + "".join(heads), *rows, f"turn {self.turn} of {self.max_turns}"])

    def _status(self) -> str:
        if not self.outcomes:
            return super()._status()
        if not self.agreed:
            return painted("no deal", "red")
        gains = (f"{seat} {worth(share, self.values[seat])}" for seat, share in self.table.items())
        return painted(f"deal: {', '.join(gains)}", "green")


class Split(NamedTuple):
    """A deal.

    Args:
        share: What the first seat gets.
        first: What it is worth to the first seat.
        second: What the rest is worth to the second seat.
    """

    share: Amounts
    first: int
    second: int


def splits(pool: Amounts, first: Amounts, second: Amounts) -> list[Split]:
    """Return all deals that are possible.

    Args:
        pool: Number of items of each kind.
        first: What one of each kind is worth to the first seat.
        second: What it is worth to the second seat.
    """
    total = worth(pool, second)
    shares = product(*(range(most + 1) for most in pool))
    return [Split(share, worth(share, first), total - worth(share, second)) for share in shares]


def pareto_frontier(pool: Amounts, first: Amounts, second: Amounts) -> list[Split]:
    """Return the deals of ``splits`` than which none is better for one seat and no worse for the other."""
    possible = splits(pool, first, second)
    gains = {(split.first, split.second) for split in possible}
    best = {own for own in gains if not any(a >= own[0] and b >= own[1] for a, b in gains - {own})}
    return [split for split in possible if (split.first, split.second) in best]


def best_joint_value(pool: Amounts, first: Amounts, second: Amounts) -> int:
    """Return the most that a deal can be worth to both seats together: each kind goes to whom it is worth more."""
    return worth(pool, tuple(map(max, first, second)))


def worth(share: Amounts, values: Amounts) -> int:
    """Return what some items are worth."""
    return sum(amount * value for amount, value in zip(share, values, strict=True))


@cache
def _pools() -> list[Amounts]:
    sizes = product(range(1, _MOST_ITEMS), repeat=len(ITEMS))
    return [pool for pool in sizes if _FEWEST_ITEMS <= sum(pool) <= _MOST_ITEMS]


@cache
def _values(pool: Amounts) -> list[tuple[Amounts, Amounts]]:
    """Return the pairs of values that may be drawn for a pool."""
    one = [each for each in product(range(POOL_VALUE + 1), repeat=len(pool)) if worth(pool, each) == POOL_VALUE]
    return [
        (first, second)
        for first in one
        for second in one
        if all(map(max, first, second)) and any(map(min, first, second))
    ]


def _split_message(text: str) -> tuple[str, str]:
    """Return what a response says to the other seat, on one line and cut to length, and the response without it."""
    end = text.rfind(_END_SAY)
    start = text.rfind(_SAY, 0, max(end, 0))
    if start < 0:
        return "", text
    said = text[start + len(_SAY) : end]
    printable = "".join(char if char.isprintable() else " " for char in said[: 4 * LONGEST_MESSAGE])
    line = " ".join(printable.split()).replace('"', "'")  # it is quoted, and must not seem to end before its end
    cut = line if len(line) <= LONGEST_MESSAGE else f"{line[:LONGEST_MESSAGE]}…"
    return cut, text[:start] + text[end + len(_END_SAY) :]


def _amounts(move: str) -> Amounts:
    return tuple(map(int, move.split()[1:]))


def _listed(amounts: Amounts) -> str:
    return ", ".join(f"{item} {amount}" for item, amount in zip(ITEMS, amounts, strict=True))


def _other(seat: str) -> str:
    return "second" if seat == "first" else "first"
