"""``TextArenaMultiAgentEnv``: a game of TextArena with all its seats open."""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import Any, ClassVar

from gem_core.env import MultiAgentEnv, Verdict
from gem_core.errors import ArgumentError, EnvFaultError
from gem_core.types import Concurrency, Info
from gem_games.textarena.judging import AgentJudge, JudgeError
from gem_games.textarena.moves import random_move
from gem_games.textarena.table import open_table

_MOST_REFUSED = 20
"""Invalid moves in a row with which a seat among several loses."""
_SCORES = "Blackjack", "Set"
"""Games of one player that pay a score, and have no aim that is reached or missed."""


class TextArenaMultiAgentEnv(MultiAgentEnv):
    """A game of TextArena; each seat, ``"player_0"``, ``"player_1"`` and so on, is an agent.

    The game says whose turn it is. Where a move is invalid, the same seat tries again, or is out of the game or has
    lost it, as TextArena has it; one that is out stays among ``agents``, and is paid when the game ends for all.

    The rewards are TextArena's own, at the end, and 0 before. An agent's info has ``textarena``, what TextArena says
    about the seat, and with its next observation ``invalid_move`` and ``parsed_action`` of its last response.
    ``correct`` at the end says whether the seat won: alone, by the full reward of 1; among others, by one
    above 0 that no other seat exceeds. Blackjack and Set, which only keep a score, have none.

    A seat sees nothing of its own responses, and of another seat's the move alone, as the game describes it or in its
    brackets. Where the game is to talk, all that is said is heard; thinking blocks never are.

    A response that makes the library raise loses with -1, if another one would not have done so; a single opponent then
    gets 1, as after an invalid move, and others get 0. Else all are truncated with ``info["error"]``. Twenty invalid
    moves in a row lose in the same way where TextArena would ask that seat for ever, as in Poker.

    Args:
        game: The game's id in TextArena.
        players: How many seats it has.
        max_turns: All are truncated when it is the turn of a seat that has had so many, with a reward of 0, or for one
            player with TextArena's for what is done. A game that takes a limit itself is made with this one; it counts
            the turns of all seats. None: 1,000, or the game's own limit if that is more.
        judge: An agent, or the name of one, that answers as the game master and the jury of GuessWho, TwentyQuestions
            and Debate.

    Source: the games and rewards of textarena 0.7.4, https://github.com/LeonGuertler/TextArena.
    """

    concurrency: ClassVar[Concurrency] = "process"

    def __init__(self, game: str, players: int = 2, max_turns: int | None = None, judge: Any = None) -> None:
        super().__init__()
        self._judge = None if judge is None else AgentJudge(judge)
        self.table = open_table(game, players, max_turns, self._verdict)
        self.game, self._family = game, game.partition("-")[0]
        self.possible_agents = tuple(f"player_{seat}" for seat in range(players))

    def begin_episode(self, options: dict[str, Any] | None) -> Mapping[str, Info]:
        """Deal a game.

        Raises:
            EnvFaultError: The judge failed.
        """
        try:
            self.table.reset(self.np_random_seed)
        except JudgeError as error:
            raise EnvFaultError(f"{self.env_id or self.game}: the judge: {error}") from error
        return self._next_turn()

    def observe(self, agent: str) -> str:
        """Return what happened since an agent acted last, and the board."""
        return "".join(self.table.look(self.possible_agents.index(agent)))

    def process_actions(self, actions: dict[str, str]) -> Verdict:
        """Play for the seat whose turn it is."""
        ((agent, action),) = actions.items()
        table = self.table
        try:
            played = table.act(str(action))
        except Exception as error:  # noqa: BLE001 - the library may raise anything; blame is told apart below
            return self._failed(agent, error)
        if not table.done and len(self.agents) > 1 and table.refused >= _MOST_REFUSED:
            return self._lost(agent, f"That was the {_MOST_REFUSED}th invalid move in a row: the game is lost.")
        told = {"invalid_move": table.invalid, "parsed_action": None if table.invalid else played}
        if not table.done and table.turns[table.seat] < table.most_turns:
            infos = self._next_turn()
            infos.setdefault(agent, {}).update(told)
            return {}, {}, {}, infos
        infos = {each: self._info(each) for each in self.agents}
        infos[agent] |= told
        ends = dict.fromkeys(self.agents, True)
        if table.done:
            rewards = {self.possible_agents[seat]: reward for seat, reward in table.rewards().items()}
        else:
            rewards = {agent: table.progress()} if len(self.agents) == 1 else {}
        for each, info in infos.items():
            info.setdefault("correct", table.done and self._has_won(rewards.get(each, 0.0), rewards))
        return rewards, ends if table.done else {}, {} if table.done else ends, infos

    def _has_won(self, reward: float, rewards: Mapping[str, float]) -> bool:
        if len(self.agents) == 1:
            return reward >= 1
        return 0 < reward == max(rewards.values())

    def _next_turn(self) -> dict[str, Info]:
        agent = self.possible_agents[self.table.seat]
        self.agent_selector.override(agent)
        return {agent: self._info(agent)}

    def _info(self, agent: str) -> Info:
        """Return an agent's info."""
        seat = self.possible_agents.index(agent)
        feedback, suffix = self.table.look(seat)
        info = {"feedback": feedback, "suffix": suffix, "textarena": self.table.report(seat)}
        # Said from the beginning, since an episode of such a game that is cut off has not failed.
        return info | {"correct": None} if self._family in _SCORES else info

    def _failed(self, agent: str, error: Exception) -> Verdict:
        """End an episode in which the library raised: by the agent's fault if a valid action was to be had."""
        table = self.table
        table.replay(table.seed, table.actions, table.verdicts)
        agents_fault = not isinstance(error, JudgeError) and table.tries(random_move(table, random.Random(table.seed)))
        if agents_fault:
            return self._lost(agent, f"The game could not read your response ({type(error).__name__}), and is lost.")
        told = {
            "kind": "judge" if isinstance(error, JudgeError) else "textarena",
            "message": f"{type(error).__name__}: {error}"[:300],
        }
        infos = {each: {**self._info(each), "error": told} for each in self.agents}
        return {}, {}, dict.fromkeys(self.agents, True), infos

    def _lost(self, agent: str, text: str) -> Verdict:
        """End the episode by the fault of an agent, which is told so."""
        self.table.tell(self.possible_agents.index(agent), text)
        rewards = dict.fromkeys(self.agents, 1.0 if len(self.agents) == 2 else 0.0) | {agent: -1.0}
        infos = {each: {**self._info(each), "correct": reward > 0} for each, reward in rewards.items()}
        infos[agent] |= {"invalid_move": True, "parsed_action": None}
        return rewards, dict.fromkeys(self.agents, True), {}, infos

    def _verdict(self, question: str) -> str:
        """Answer as the judge."""
        if self._judge is None:
            raise JudgeError(f"{self.game} has a judge: make it with judge=, an agent or the name of one")
        return self._judge.ask(question, str(self.table.seed), self.env_id or self.game)

    def sample_random_action(self, agent: str) -> str:  # type: ignore[override]  # an agent has to be named
        """Return a move that TextArena takes as a valid one; where there is none, ``"[no move]"``.

        Raises:
            ArgumentError: It is not the turn of this agent.
        """
        if agent not in self.acting and not self.table.done:
            raise ArgumentError(f"{self.env_id or self.game}: it is not the turn of {agent!r}")
        return random_move(self.table, random.Random(int(self.action_random.integers(2**53))))
