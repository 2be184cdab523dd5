"""PettingZoo's rock paper scissors, tic-tac-toe and connect four, with text views of our own."""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar

import pettingzoo  # type: ignore[import-untyped]

from gem_core.env import Verdict
from gem_core.types import Info
from gem_pettingzoo.imports import PettingZooEnv

_GESTURES = ("rock", "paper", "scissors", "spock", "lizard")


class _ClassicEnv(PettingZooEnv):
    """A game of two: it ends for both at once, and the one whose rewards sum up to more than 0 has won."""

    def process_actions(self, actions: dict[str, str]) -> Verdict:
        """Play, and say at the end who has won; a last round that the rules announce is an end, not a cut."""
        rewards, terminations, truncations, infos = super().process_actions(actions)
        over = [agent for agent in self.agents if terminations.get(agent) or truncations.get(agent)]
        told = dict(infos)
        for agent in over:
            won = self.cumulative[agent] + rewards.get(agent, 0.0) > 0
            told[agent] = {**infos.get(agent, {}), "correct": won}
        return rewards, dict.fromkeys(over, True), {}, told

    def _is_first(self, agent: str) -> bool:
        """Tell whether an agent is to act for the first time."""
        return agent in self.agents and not any(agent in moves for moves in self.moves)

    def _outcome(self, agent: str) -> str:
        """Return how the game ended for an agent; nothing while it goes on, if it was cut off, and after a forfeit."""
        if self._forfeited or not self.terminations.get(agent):
            return ""
        total = self.cumulative[agent]
        return "You won." if total > 0 else "You lost." if total < 0 else "It is a draw."


class _BoardEnv(_ClassicEnv):
    """A board game of X, who begins, against O."""

    game: ClassVar[str]
    rules: ClassVar[str]
    move: ClassVar[str]

    def __init__(self, *, retries: int = 2) -> None:
        super().__init__(partial(pettingzoo.make, "aec", self.game), retries=retries)

    def describe(self, agent: str, observation: Any, info: Info) -> str:
        """Return the rules at first, the result at the end, the last move, the own mark, and the board."""
        own, other = ("X", "O") if agent == self.possible_agents[0] else ("O", "X")
        pieces = [self._outcome(agent), self.rules if self._is_first(agent) else ""]
        for mover, action in self.moves[-1].items() if self.moves else ():
            pieces.append(self.move.format(who="You" if mover == agent else other, action=action))
        marks = [
            [own if mine else other if theirs else "" for mine, theirs in row] for row in observation["observation"]
        ]
        before_answer = ["", ""] if agent in self.agents else []
        return "\n".join([*filter(None, pieces), f"You are {own}.", "", self._board(marks), *before_answer])

    def _board(self, marks: list[list[str]]) -> str:
        raise NotImplementedError


class TicTacToeEnv(_BoardEnv):
    """PettingZoo's ``tictactoe_v3``.

    - The game is won: reward 1 for the winner, and -1 for the other player.
    - A draw, and every move before the end: reward 0.

    A response without a legal move is answered to that player alone, who tries again. After ``retries`` more in a row
    the player forfeits: reward -1, nothing for the other one, and the game is over.

    Args:
        retries: How often a player may try again after a response without a legal move, before it forfeits.
    """

    game = "classic/tictactoe_v3"
    rules = (
        "This is tic-tac-toe: the players mark a free square in turn. Three own marks in a row, a column or a diagonal "
        "win; a full board without that is a draw. X begins. A free square shows its number."
    )
    move = "{who} took square {action}."

    def _board(self, marks: list[list[str]]) -> str:
        # PettingZoo numbers the squares column by column.
        rows = [" | ".join(marks[column][row] or str(3 * column + row) for column in range(3)) for row in range(3)]
        return "\n--+---+--\n".join(rows)


class ConnectFourEnv(_BoardEnv):
    """PettingZoo's ``connect_four_v3``.

    - The game is won: reward 1 for the winner, and -1 for the other player.
    - A draw, and every move before the end: reward 0.

    A response without a legal move is answered to that player alone, who tries again. After ``retries`` more in a row
    the player forfeits: reward -1, nothing for the other one, and the game is over.

    Args:
        retries: How often a player may try again after a response without a legal move, before it forfeits.
    """

    game = "classic/connect_four_v3"
    rules = (
        "This is connect four: the players drop a disc into a column in turn, where it falls to the lowest free place. "
        "Four own discs in a row, a column or a diagonal win; a full board without that is a draw. X begins. The "
        "numbers of the columns stand above them, and a dot is a free place."
    )
    move = "{who} chose column {action}."

    def _board(self, marks: list[list[str]]) -> str:
        return "\n".join(["0 1 2 3 4 5 6", *(" ".join(mark or "." for mark in row) for row in marks)])


class RockPaperScissorsEnv(_ClassicEnv):
    """PettingZoo's ``rps_v2``: both choose at once, round after round.

    - In each round 1 for the winner and -1 for the other player; 0 for both if they chose alike.

    A response without a gesture is answered to that player alone, who tries again. After ``retries`` more in a row
    the player forfeits: reward -1, nothing for the other one, and the game is over.

    Args:
        num_actions: Odd number of gestures, 3 or more; with 5 there are Spock and lizard.
        max_cycles: Number of rounds.
        retries: How often a player may try again after a response without a gesture, before it forfeits.
    """

    def __init__(self, *, num_actions: int = 3, max_cycles: int = 15, retries: int = 2) -> None:
        more = [f"action_{number + 1}" for number in range(len(_GESTURES), num_actions)]
        self.names = [*_GESTURES[:num_actions], *more]
        make = partial(pettingzoo.make, "parallel", "classic/rps_v2", num_actions=num_actions, max_cycles=max_cycles)
        super().__init__(make, action_names=self.names, retries=retries)
        self.rounds = max_cycles

    def describe(self, agent: str, observation: Any, info: Info) -> str:
        """Return the rules at first, the last round, the score, and which round it is."""
        pieces = [self._outcome(agent)]
        if self._is_first(agent):
            pieces.append(self._rules())
        rounds = [(moves[agent], next(moves[other] for other in moves if other != agent)) for moves in self.moves]
        if rounds:
            own, other = rounds[-1]
            won, lost = sum(_beats(*each) for each in rounds), sum(_beats(b, a) for a, b in rounds)
            result = "you won" if _beats(own, other) else "you lost" if _beats(other, own) else "nobody won"
            pieces += [
                f"You chose {self.names[own]}, and your opponent {self.names[other]}: {result} the round.",
                f"Rounds so far: {won} won, {lost} lost, {len(rounds) - won - lost} drawn.",
            ]
        if agent in self.agents:
            pieces.append(f"Round {len(rounds) + 1} of {self.rounds}.")
        return "\n".join(filter(None, pieces))

    def _rules(self) -> str:
        title = ", ".join(self.names)
        beaten = [
            [loser for number, loser in enumerate(self.names) if _beats(each, number)]
            for each in range(len(self.names))
        ]
        table = "; ".join(
            f"{name} beats {' and '.join(losers)}" for name, losers in zip(self.names, beaten, strict=True)
        )
        return (
            f"This is {title} in {self.rounds} rounds. In each, you and your opponent choose at once: {table}. "
            "A round is worth 1 to who wins it and -1 to who loses it; the same choice is a draw."
        )


def _beats(gesture: int, other: int) -> bool:
    """Tell whether a gesture wins: the lower number of two even or two odd ones, else the higher.

    Source: the rewards of ``rps_v2``, https://pettingzoo.farama.org/environments/classic/rps/.
    """
    return gesture != other and (gesture < other) == ((gesture + other) % 2 == 0)
