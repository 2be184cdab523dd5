"""``to_aec`` and ``to_parallel``: a ``MultiAgentEnv`` as an environment of PettingZoo."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from pettingzoo import AECEnv, ParallelEnv  # type: ignore[import-untyped]
from pettingzoo.utils import OrderEnforcingWrapper  # type: ignore[import-untyped]

from gem_core.env import MultiAgentEnv, Text
from gem_core.errors import ArgumentError
from gem_core.types import Info, Observation

if TYPE_CHECKING:
    from gymnasium import spaces


def to_aec(env: MultiAgentEnv) -> Any:
    """Return an environment as PettingZoo's ``AECEnv``, whose agents act one after another.

    Agents that act at once are asked in turn, and the environment is stepped when all of them have acted. What an agent
    earned is in ``rewards`` when it acts next or has ended. ``observe`` returns what an agent was shown last: ``""``
    for one that has not been asked yet.

    Args:
        env: Any environment of several agents. It belongs to the result, which steps and closes it.

    Returns:
        An ``AECEnv``, in PettingZoo's ``OrderEnforcingWrapper``.

    Raises:
        ArgumentError: It is an environment of one agent.

    Source: the agent environment cycle of PettingZoo, arXiv:2009.14471.
    """
    return OrderEnforcingWrapper(_TurnTakingEnv(env))


def to_parallel(env: MultiAgentEnv) -> Any:
    """Return an environment as PettingZoo's ``ParallelEnv``, to which all agents give an action in each step.

    Where only some agents act now, ``infos[agent]["acting"]`` says which; the others see what they were shown last
    (``""`` before that), and what they give as an action is ignored, as PettingZoo's ``turn_based_aec_to_parallel``
    does.

    Args:
        env: Any environment of several agents. It belongs to the result, which steps and closes it.

    Returns:
        A ``ParallelEnv``; its ``step`` raises ``ArgumentError`` where the action of an agent that acts is missing.

    Raises:
        ArgumentError: It is an environment of one agent.
    """
    return _AllAtOnceEnv(env)


class _ShownText(str):
    """Text with the ``dtype`` of its space, which ``pettingzoo.test.api_test`` compares."""

    __slots__ = ()
    dtype = Text().dtype


class _Converted:
    """What both conversions keep: spaces, and what each agent was shown last."""

    def __init__(self, env: MultiAgentEnv) -> None:
        if not isinstance(env.unwrapped, MultiAgentEnv):
            raise ArgumentError(
                f"PettingZoo's environments are of several agents, so give a MultiAgentEnv, not {env.unwrapped!r:.100}"
            )
        self.env = env
        self.possible_agents = list(env.possible_agents)
        name = env.unwrapped.env_id or type(env.unwrapped).__name__
        self.metadata = {**env.metadata, "name": name, "is_parallelizable": False}
        self.render_mode = env.render_mode
        # Kept, since PettingZoo promises the same object each time, so that seeding one is not lost.
        self._observation_spaces = {agent: env.observation_space(agent) for agent in self.possible_agents}
        self._action_spaces = {agent: env.action_space(agent) for agent in self.possible_agents}
        self._shown: dict[str, Observation] = {}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        return self._action_spaces[agent]

    def render(self) -> Any:
        return self.env.render()

    def close(self) -> None:
        self.env.close()

    def _begin(self, seed: int | None, options: dict[str, Any] | None) -> tuple[list[str], dict[str, Info]]:
        """Reset the environment, and return who acts first and the infos."""
        self._shown = {}
        observations, infos = self.env.reset(seed=seed, options=options)
        self.agents = list(self.env.agents)
        self._show(self.agents, observations, infos)
        return list(observations), infos

    def _show(self, agents: Iterable[str], observations: Mapping[str, Observation], infos: dict[str, Info]) -> None:
        """Keep what agents are shown, and take the last observation of those who ended out of their infos."""
        for agent in agents:
            ended_with = infos.get(agent, {}).pop("final_obs", self._shown.get(agent, ""))
            shown = observations.get(agent, ended_with)
            self._shown[agent] = _ShownText(shown) if isinstance(shown, str) else shown

    def _take_part(self, infos: Mapping[str, Info]) -> list[str]:
        """Return those who took part before a step, followed by those who joined in it."""
        return list(dict.fromkeys([*self.agents, *self.env.agents, *infos]))


class _TurnTakingEnv(_Converted, AECEnv):  # type: ignore[misc]  # PettingZoo has no types
    """See ``to_aec``."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        self._acting, infos = self._begin(seed, options)
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.infos: dict[str, Info] = {agent: infos.get(agent, {}) for agent in self.agents}
        self.agent_selection = self._acting[0]
        self._skip_agent_selection = None  # of AECEnv: who acts after the agents that ended
        self._actions: dict[str, str] = {}

    def observe(self, agent: str) -> Observation:
        return self._shown[agent]

    def step(self, action: str | None) -> None:
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        if not isinstance(action, str):
            raise ArgumentError(f"the action of {agent!r} must be text, not {action!r:.100}")
        self._clear_rewards()
        self._cumulative_rewards[agent] = 0.0
        self._actions[agent] = action
        waiting = [each for each in self._acting if each not in self._actions]
        if waiting:
            self.agent_selection = waiting[0]
            return
        actions, self._actions = self._actions, {}
        self._take_in(*self.env.step(actions))

    def _take_in(
        self,
        observations: Mapping[str, Observation],
        rewards: Mapping[str, float],
        terminations: Mapping[str, bool],
        truncations: Mapping[str, bool],
        infos: dict[str, Info],
    ) -> None:
        """Take over the result of a step; those who ended come first, for the step that takes them out."""
        self.agents = self._take_part(infos)
        self._show(self.agents, observations, infos)
        self.rewards = {agent: rewards.get(agent, 0.0) for agent in self.agents}
        self._cumulative_rewards = {agent: self._cumulative_rewards.get(agent, 0.0) for agent in self.agents}
        self._accumulate_rewards()
        self.terminations = {agent: terminations[agent] for agent in self.agents}
        self.truncations = {agent: truncations[agent] for agent in self.agents}
        self.infos = {agent: infos.get(agent, self.infos.get(agent, {})) for agent in self.agents}
        self._acting = list(observations)
        if self._acting:
            self.agent_selection = self._acting[0]
        self._deads_step_first()


class _AllAtOnceEnv(_Converted, ParallelEnv):  # type: ignore[misc]  # PettingZoo has no types
    """See ``to_parallel``."""

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, Info]]:
        self._acting, infos = self._begin(seed, options)
        return dict(self._shown), self._told(self.agents, infos)

    def step(self, actions: Mapping[str, str]) -> tuple[dict[str, Any], ...]:
        asked = {agent: actions[agent] for agent in self._acting if agent in actions}
        observations, rewards, terminations, truncations, infos = self.env.step(asked)
        took_part = self._take_part(infos)
        self.agents = list(self.env.agents)
        self._show(took_part, observations, infos)
        self._acting = list(observations)
        return (
            {agent: self._shown[agent] for agent in took_part},
            {agent: rewards.get(agent, 0.0) for agent in took_part},
            {agent: terminations[agent] for agent in took_part},
            {agent: truncations[agent] for agent in took_part},
            self._told(took_part, infos),
        )

    def _told(self, agents: Iterable[str], infos: Mapping[str, Info]) -> dict[str, Info]:
        return {agent: {**infos.get(agent, {}), "acting": agent in self._acting} for agent in agents}
