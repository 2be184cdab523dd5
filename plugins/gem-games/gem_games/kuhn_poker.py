r"""KuhnPoker: poker with three cards and one bet, for two seats."""

from __future__ import annotations

from gem_games.cheap_random import CheapRandom
from gem_games.game import painted
from gem_games.joint_game import JointGame

CARDS = "jack", "queen", "king"
"""From the lowest to the highest."""

_MOVES = frozenset({"check", "bet", "call", "fold"})


class KuhnPokerEnv(JointGame):
    r"""Bet on the higher of two cards, by moves such as ``\boxed{check}``.

    Each seat puts one chip into the pot and gets one of three cards, jack, queen and king. The first checks or bets one
    chip; then so does the second, unless there is a bet, which it calls or folds. If the second bets after a check, the
    first calls or folds. Who folds loses the pot; otherwise the higher card wins it.

    - Reward: the chips won or lost, 1, or 2 after a call.
    - A move that is not possible now does nothing; the third in a row loses 2 chips to the other seat. See
      ``JointGame``.

    A card is shown to the other seat in a showdown alone. Between perfect players the first seat loses 1/18 of a chip
    in a game; ``gem_games.kuhn_strategy`` has their strategies and computes values exactly.

    Source: H. W. Kuhn, A simplified two-person poker, Contributions to the Theory of Games I, 1950.
    """

    possible_agents = ("first", "second")
    stake = 2
    unreadable = "is not one of check, bet, call and fold."

    def __init__(self) -> None:
        super().__init__()
        self.cards: dict[str, str] = {}
        self.history: tuple[str, ...] = ()
        """The moves so far."""

    def _deal(self, draws: CheapRandom) -> None:
        deck = list(CARDS)
        self.cards = {seat: deck.pop(draws.below(len(deck))) for seat in self.possible_agents}
        self.history = ()

    def _rules(self, seat: str) -> str:
        return (
            "Kuhn poker: two players, called first and second, and three cards: jack, queen and king, the king being "
            "the highest.\n"
            "Each player has put one chip into the pot and holds one card, which the other does not see.\n"
            "The first player checks, or bets one chip. The second then does the same, but answers a bet by a call, "
            "which adds one chip too, or by a fold. If the second bets after a check, the first calls or folds.\n"
            "Who folds loses the pot to the other. Otherwise the higher card wins it. Your reward is the number of "
            "chips that you win or lose.\n"
            "Write your move inside \\boxed{}.\n"
        )

    def _situation(self, seat: str) -> str:
        played = ", ".join(f"{who} {move}" for who, move in zip(_TURNS, self.history, strict=False))
        options = " or ".join(f"\\boxed{{{move}}}" for move in legal_moves(self.history))
        return f"\nYou are the {seat} player and hold the {self.cards[seat]}. Moves so far: {played or 'none'}.\n" + (
            self._ending(seat) if self.outcomes else f"Answer {options}."
        )

    def _read(self, answer: str) -> str | None:
        move = answer.lower()
        return move if move in _MOVES else None

    def _fault(self, seat: str, move: str) -> str:
        options = legal_moves(self.history)
        return "" if move in options else f"You cannot {move} now, only {options[0]} or {options[1]}."

    def _play(self, moves: dict[str, str]) -> tuple[dict[str, float], bool]:
        ((seat, move),) = moves.items()
        self.history += (move,)
        for each in self.possible_agents:
            self._tell(each, f"You {move}." if each == seat else f"The {seat} player {move}s.")
        if legal_moves(self.history):
            return {}, False
        won = chips_won(self.cards["first"], self.cards["second"], self.history)
        if move != "fold":
            for mine, its in (("first", "second"), ("second", "first")):
                self._tell(mine, f"Showdown: you hold the {self.cards[mine]}, the {its} player the {self.cards[its]}.")
        rewards = {"first": float(won), "second": float(-won)}
        for each, reward in rewards.items():
            chips = "1 chip" if abs(won) == 1 else f"{abs(won)} chips"
            self._tell(each, f"You {'win' if reward > 0 else 'lose'} {chips}.")
        return rewards, True

    def _random_answer(self, seat: str) -> str:
        """Draw a possible move."""
        options = legal_moves(self.history)
        return options[int(self.action_random.random() * len(options))]

    def _drawing(self) -> str:
        shown = self.cards if self.outcomes else dict.fromkeys(self.cards, "?")
        cards = "   ".join(f"{seat}: {painted(card, 'bold')}" for seat, card in shown.items())
        return f"{cards}\n{' · '.join(self.history) or 'no move yet'}"


_TURNS = "first", "second", "first"


def legal_moves(history: tuple[str, ...]) -> tuple[str, ...]:
    """Return the moves that are possible after others; none after the end."""
    if history[-1:] == ("bet",):
        return "call", "fold"
    return ("check", "bet") if history in ((), ("check",)) else ()


def chips_won(first: str, second: str, history: tuple[str, ...]) -> int:
    """Return how many chips the first player wins by a game that is over; negative for a loss.

    Args:
        first: Its card.
        second: The card of the second player.
        history: All moves.
    """
    if history[-1] == "fold":
        return -1 if len(history) == 3 else 1  # the first folds a bet after its check, the second one at once
    stake = 2 if history[-1] == "call" else 1
    return stake if CARDS.index(first) > CARDS.index(second) else -stake
