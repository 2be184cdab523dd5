"""``TextArenaEnv``: one seat at a game of TextArena; the other seats, if there are any, are played inside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.rollouts import SingleAgentEnv
from gem_games.textarena.multi_agent import TextArenaMultiAgentEnv


class TextArenaEnv(SingleAgentEnv):
    """A seat at a game of TextArena; the other seats are played by opponents. See ``TextArenaMultiAgentEnv``.

    An opponent that fails truncates the episode with ``info["error"]``; so does it if the agent's turn does not come in
    300 turns of the opponents. A game that is over before the agent's first turn is dealt anew.

    Args:
        game: The game's id in TextArena.
        players: How many seats it has.
        seat: Which of them the agent holds.
        opponents: ``"random"``, an agent or the name of one (as in ``"openai:MODEL"``), or a sequence or mapping by
            seat of these. Seats that a mapping leaves out play at random. An agent that reads messages is sent the
            conversation of its seat.
        max_turns: As for ``TextArenaMultiAgentEnv``.
        judge: An agent, or the name of one, that answers as the game master and the jury of GuessWho, TwentyQuestions
            and Debate.
    """

    def __init__(
        self,
        game: str,
        players: int = 1,
        seat: int = 0,
        opponents: Any = "random",
        max_turns: int | None = None,
        judge: Any = None,
    ) -> None:
        env = TextArenaMultiAgentEnv(game, players, max_turns, judge)
        if type(seat) is not int or not 0 <= seat < players:
            raise ArgumentError(f"seat must be a whole number from 0 to {players - 1}, not {seat!r}")
        others = [other for other in range(players) if other != seat]
        by_seat = {env.possible_agents[other]: player for other, player in _by_seat(opponents, others).items()}
        super().__init__(env, env.possible_agents[seat], by_seat)
        self.game, self.table = game, env.table


def _by_seat(opponents: Any, others: list[int]) -> dict[int, Any]:
    """Return who plays each of the other seats.

    Raises:
        ArgumentError: They are not for these seats.
    """
    if isinstance(opponents, Mapping):
        wrong = [key for key in opponents if key not in others]
        if wrong:
            raise ArgumentError(f"opponents names seat {wrong[0]!r}, and the other seats are {others}")
        return dict(opponents)
    if isinstance(opponents, Sequence) and not isinstance(opponents, str):
        if len(opponents) != len(others):
            raise ArgumentError(f"opponents must be {len(others)}, one for each other seat, not {len(opponents)}")
        return dict(zip(others, opponents, strict=True))
    return dict.fromkeys(others, opponents)
