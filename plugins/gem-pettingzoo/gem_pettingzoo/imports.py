"""``from_pettingzoo``: an environment of PettingZoo as a ``MultiAgentEnv`` with text views."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self

from gymnasium import spaces
from gymnasium.utils import EzPickle
from pettingzoo import AECEnv, ParallelEnv  # type: ignore[import-untyped]

from gem_core.env import MultiAgentEnv, Verdict, join_observations
from gem_core.errors import ArgumentError, SamplingNotSupported
from gem_core.records import to_plain
from gem_core.types import Info, Observation
from gem_pettingzoo.driving import Position, look, reset_env, step_env
from gem_pettingzoo.texts import ActionText, describe_observation, legal_numbers, mask_of

Describe = Callable[[str, Any, Info], Observation]
"""``(agent, observation, info) -> text``: what an agent is shown of PettingZoo's observation and info."""

Read = Callable[[str, str], Any]
"""``(agent, response) -> action``: the action in a response; None where there is none."""


def _layers(env: Any) -> Iterator[Any]:
    """Yield an environment of PettingZoo, and those inside it."""
    while isinstance(env, AECEnv | ParallelEnv):
        yield env
        env = next((vars(env)[name] for name in ("env", "aec_env", "par_env") if name in vars(env)), None)


class PettingZooEnv(MultiAgentEnv):
    r"""An environment of PettingZoo, seen as text: ``AECEnv`` by turns, ``ParallelEnv`` with all agents at once.

    By default an agent is shown the observation as compact text and how to answer: with the number or name of a legal
    action in ``\boxed{}`` (see ``ActionText`` for other spaces). A subclass may override ``describe`` and ``read``.

    A response without a legal action is answered to that agent alone, and it acts again. When it has failed
    ``retries`` more times in a row it forfeits: it gets ``illegal_reward``, and the episode is terminated for all, the
    others without a reward, as PettingZoo's ``TerminateIllegalWrapper`` does.

    A fork has a deep copy of PettingZoo's environment.

    Args:
        env: The environment, or a function without arguments that makes it, which ``rollout`` and ``gem.register``
            need.
        describe: What an agent is shown; ``(agent, observation, info) -> text``.
        read: Finds the action in a response, or None; ``(agent, response) -> action``. ``describe`` then says how to
            answer, and random actions cannot be sampled.
        action_names: Names of the actions of ``Discrete`` spaces, the lowest number first.
        retries: How often an agent may try again after a response without a legal action.
        illegal_reward: Reward of an agent that forfeits.

    Raises:
        ArgumentError: ``env`` is no environment of PettingZoo, does not name its ``possible_agents``, or has actions
            without a text form and ``read`` is not given.
    """

    moves: list[dict[str, Any]]
    """The actions that were played in this episode, one mapping by agent for each step of PettingZoo's environment."""

    _ready: dict[str, Any]
    """Legal actions of those who have acted, while others try again."""

    _failures: dict[str, int]
    """How many responses in a row of an agent had no legal action."""

    _forfeited: list[str]
    _seen: dict[str, tuple[Any, Info]]

    def __init__(
        self,
        env: Any,
        *,
        describe: Describe | None = None,
        read: Read | None = None,
        action_names: Sequence[str] = (),
        retries: int = 2,
        illegal_reward: float = -1.0,
    ) -> None:
        super().__init__()
        if not callable(env):
            self._init_args = (_refuse_second, *self._init_args[0][1:]), self._init_args[1]
        self.pettingzoo_env = env() if callable(env) else env
        if not isinstance(self.pettingzoo_env, AECEnv | ParallelEnv):
            raise ArgumentError(
                f"from_pettingzoo takes an AECEnv or a ParallelEnv, not {type(self.pettingzoo_env).__name__}"
            )
        if not hasattr(self.pettingzoo_env, "possible_agents"):  # PettingZoo does not ask for it
            raise ArgumentError(f"{self.pettingzoo_env} does not name its possible_agents")
        self.possible_agents = list(self.pettingzoo_env.possible_agents)
        self._action_spaces = {agent: self.pettingzoo_env.action_space(agent) for agent in self.possible_agents}
        self._describe, self._read = describe, read
        self._texts = (
            {} if read else {agent: ActionText(space, action_names) for agent, space in self._action_spaces.items()}
        )
        self.retries, self.illegal_reward = retries, illegal_reward
        self._options: dict[str, Any] | None = None
        self._begin()

    def describe(self, agent: str, observation: Any, info: Info) -> Observation:
        """Return what an agent is shown of PettingZoo's observation and info, when it acts and when it has ended."""
        return self._describe(agent, observation, info) if self._describe else describe_observation(observation)

    def read(self, agent: str, response: str) -> Any:
        """Return the action in a response; None if there is none."""
        return self._read(agent, response) if self._read else self._texts[agent].read(response)

    def begin_episode(self, options: dict[str, Any] | None) -> dict[str, Info]:
        """Reset PettingZoo's environment with the seed of this episode and the options."""
        self._options = options
        position = self._restart()
        self.agents = [agent for agent in self.possible_agents if agent in self.pettingzoo_env.agents]
        self.agent_selector.override(*position.acting)
        return {agent: to_plain(info) for agent, (_, info) in position.seen.items()}

    def observe(self, agent: str) -> Observation:
        """Return what happened to its last response, what it sees, and how it answers."""
        pieces: list[Observation] = []
        playing = agent in self.agents
        if playing and agent in self._failures:
            left = self.retries + 1 - self._failures[agent]
            pieces.append(f"Your last response has no legal action. You forfeit after {left} more without one.")
        pieces += [
            f"{'You forfeit' if each == agent else f'{each} forfeits'} for want of a legal action; the episode is over."
            for each in self._forfeited
        ]
        self._seen.update(look(self.pettingzoo_env, agent))
        if agent in self._seen:
            pieces.append(self.describe(agent, *self._seen[agent]))
        if playing and agent in self._texts:
            pieces.append(self._texts[agent].how_to_answer(self._mask(agent)))
        return join_observations(pieces)

    def process_actions(self, actions: dict[str, str]) -> Verdict:
        """Play the actions of all who act, once each has given a legal one."""
        infos: dict[str, Info] = {}
        for agent, response in actions.items():
            action = self.read(agent, response)
            if self._is_legal(agent, action):
                self._failures.pop(agent, None)
                self._ready[agent] = action
            else:
                self._failures[agent] = self._failures.get(agent, 0) + 1
                action = None
            if not isinstance(action, str):  # text is played to the letter, and says what it was itself
                infos[agent] = {"parsed_action": self._written(agent, action)}
        self._forfeited = [agent for agent, count in self._failures.items() if count > self.retries]
        if self._forfeited:
            rewards = dict.fromkeys(self._forfeited, self.illegal_reward)
            return rewards, dict.fromkeys(self.agents, True), {}, infos
        if self._failures:
            self.agent_selector.override(*self._failures)
            return {}, {}, {}, infos
        return self._play(infos)

    def sample_random_action(self, agent: str) -> str:  # type: ignore[override]  # as in MultiAgentEnv
        """Return a response with a random legal action."""
        if agent not in self._texts:
            raise SamplingNotSupported("actions cannot be sampled where a function reads them; leave out read=")
        return self._texts[agent].sample(self._mask(agent), self.action_random)

    def close(self) -> None:
        """Close PettingZoo's environment."""
        self.pettingzoo_env.close()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # Most of PettingZoo's environments are made with EzPickle, by which a copy is a new one that was never reset.
        originals = [layer for layer in _layers(self.pettingzoo_env) if isinstance(layer, EzPickle)]
        for layer in originals:
            memo[id(layer)] = object.__new__(type(layer))
        for layer in originals:
            vars(memo[id(layer)]).update(copy.deepcopy(vars(layer), memo))
        return super().__deepcopy__(memo)

    def _begin(self) -> None:
        """Forget the episode before."""
        self.moves = []
        self._ready, self._failures, self._forfeited, self._seen = {}, {}, [], {}

    def _restart(self) -> Position:
        """Reset PettingZoo's environment."""
        self._begin()
        position = reset_env(self.pettingzoo_env, self.np_random_seed, self._options)
        self._seen.update(position.seen)
        return position

    def _advance(self, moves: dict[str, Any]) -> Position:
        """Step PettingZoo's environment."""
        self.moves.append(moves)
        position = step_env(self.pettingzoo_env, moves)
        self._seen.update(position.seen)
        return position

    def _play(self, infos: dict[str, Info]) -> Verdict:
        """Step PettingZoo's environment with the actions that are ready, and return the results by agent."""
        position = self._advance({agent: self._ready[agent] for agent in self.agents if agent in self._ready})
        self._ready = {}
        for agent in self.pettingzoo_env.agents:
            if agent not in self.terminations:
                self.add_agent(agent)
        self.agent_selector.override(*position.acting)
        for agent, (_, info) in position.seen.items():
            infos[agent] = {**infos.get(agent, {}), **to_plain(info)}
        rewards = {agent: reward for agent, reward in position.rewards.items() if agent in self.agents}
        return rewards, position.terminations, position.truncations, infos

    def _mask(self, agent: str) -> Any:
        return mask_of(self._action_spaces[agent], *self._seen[agent])

    def _is_legal(self, agent: str, action: Any) -> bool:
        space = self._action_spaces[agent]
        if action is None or not space.contains(action):
            return False
        return not isinstance(space, spaces.Discrete) or int(action) in legal_numbers(space, self._mask(agent))

    def _written(self, agent: str, action: Any) -> Any:
        return self._texts[agent].write(action) if action is not None and self._texts else to_plain(action)


def _refuse_second() -> Any:
    """Stand for a PettingZoo environment when it is made again: two cannot share it."""
    raise ArgumentError(
        "to make another, it needs a PettingZoo environment of its own: give from_pettingzoo a function, "
        'as in from_pettingzoo(lambda: pettingzoo.make("aec", "classic/chess_v6"))'
    )


from_pettingzoo = PettingZooEnv
"""The way to make one, named as ``to_aec`` and ``to_parallel`` are."""
