r"""RockPaperScissors: two seats move at once, in one round or several; with the best response to any mixture."""

from __future__ import annotations

from collections.abc import Mapping

from gem_core.env import AgentSelector
from gem_core.errors import ArgumentError
from gem_games.cheap_random import CheapRandom
from gem_games.game import painted
from gem_games.joint_game import JointGame

MOVES = "rock", "paper", "scissors"
"""Each beats the one before it, and the first the last."""

_MOST_ROUNDS = 100


class RockPaperScissorsEnv(JointGame):
    r"""Choose rock, paper or scissors at once with the other seat, by moves such as ``\boxed{rock}``.

    - In each round 1 for the winner and -1 for the other; 0 for both if they chose alike.
    - An answer that is none of the three does nothing: that seat answers again, before it learns what the other chose;
      the third in a row loses all rounds. See ``JointGame``.

    The seat that has won more rounds has won. Nothing is drawn: every seed gives the same game. Choosing at random, as
    the agent ``random`` does, is the only equilibrium; a seat that can be foreseen loses only over several rounds, to
    one that learns from what it sees.

    Args:
        rounds: Number of rounds, from 1 to 100.

    Raises:
        ArgumentError: ``rounds`` is out of range.
    """

    possible_agents = ("left", "right")
    unreadable = "is not one of rock, paper and scissors."

    def __init__(self, rounds: int = 1) -> None:
        super().__init__()
        if type(rounds) is not int or not 1 <= rounds <= _MOST_ROUNDS:
            raise ArgumentError(f"rounds must be a whole number from 1 to {_MOST_ROUNDS}, not {rounds!r}")
        self.rounds = rounds
        self.stake = rounds
        self.agent_selector = AgentSelector(mode="parallel")
        self.history: list[tuple[str, str]] = []
        """What left and right chose in each round so far."""

    def _deal(self, draws: CheapRandom) -> None:
        self.history = []

    def _rules(self, seat: str) -> str:
        rounds = "one round is played" if self.rounds == 1 else f"{self.rounds} rounds are played"
        return (
            "Rock, paper, scissors: you and another player choose at the same time. Rock beats scissors, scissors beat "
            f"paper, and paper beats rock; {rounds}.\n"
            "Your reward for a round is 1 if you win it, -1 if you lose it, and 0 if you chose alike.\n"
            "Write your choice inside \\boxed{}.\n"
        )

    def _situation(self, seat: str) -> str:
        place = self.possible_agents.index(seat)
        so_far = ", ".join(f"{choices[place]}-{choices[1 - place]}" for choices in self.history)
        todo = (
            self._ending(seat)
            if self.outcomes
            else f"Round {len(self.history) + 1} of {self.rounds}. "
            "Answer \\boxed{rock}, \\boxed{paper} or \\boxed{scissors}."
        )
        return f"\nRounds so far, your choice first: {so_far or 'none'}.\n{todo}"

    def _read(self, answer: str) -> str | None:
        choice = answer.lower()
        return choice if choice in MOVES else None

    def _play(self, moves: dict[str, str]) -> tuple[dict[str, float], bool]:
        left, right = moves["left"], moves["right"]
        self.history.append((left, right))
        won = points(left, right)
        for seat, mine, its, score in (("left", left, right, won), ("right", right, left, -won)):
            verdict = ("is drawn", "is yours", "is lost")[score]
            self._tell(seat, f"You chose {mine}, the other player {its}: the round {verdict}.")
        return {"left": float(won), "right": float(-won)}, len(self.history) == self.rounds

    def _random_answer(self, seat: str) -> str:
        """Draw one of the three."""
        return MOVES[int(self.action_random.random() * 3)]

    def _drawing(self) -> str:
        rows = (f"{left:>8} : {right}" for left, right in self.history)
        return "\n".join([painted("    left : right", "bold"), *rows])


def points(mine: str, other: str) -> int:
    """Return what a move gets against another: 1, 0 or -1."""
    return (0, 1, -1)[(MOVES.index(mine) - MOVES.index(other)) % 3]


def best_response(mixture: Mapping[str, float]) -> tuple[str, float]:
    """Return the move that gets the most against a mixed strategy, and what it gets in a round on average.

    What it gets is the exploitability of the mixture: 0 for a third each, and at most 1.

    Args:
        mixture: How likely each move is, as numbers or fractions; those that are left out are not made.
    """
    gains = {move: sum(points(move, other) * share for other, share in mixture.items()) for move in MOVES}
    best = max(gains, key=gains.__getitem__)
    return best, gains[best]
