"""Reset and step an environment of PettingZoo of either kind, and say who acts next and what changed."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pettingzoo import AECEnv  # type: ignore[import-untyped]

from gem_core.types import Info


class Position(NamedTuple):
    """Where the environment stands.

    Args:
        acting: Who acts next.
        seen: PettingZoo's observation and info of those, and of those who ended.
        rewards: What each agent earned in the step.
        terminations: Of those who ended.
        truncations: Of those who ended.
    """

    acting: list[str]
    seen: dict[str, tuple[Any, Info]]
    rewards: dict[str, float]
    terminations: dict[str, bool]
    truncations: dict[str, bool]


def reset_env(env: Any, seed: int, options: dict[str, Any] | None) -> Position:
    """Reset an ``AECEnv`` or a ``ParallelEnv``."""
    result = env.reset(seed=seed, options=options)
    if isinstance(env, AECEnv):
        return _next_turn(env, {})
    observations, infos = result
    seen = {agent: (observations[agent], infos.get(agent, {})) for agent in env.agents}
    return Position(list(env.agents), seen, {}, {}, {})


def step_env(env: Any, actions: dict[str, Any]) -> Position:
    """Step an ``AECEnv`` with the action of the agent whose turn it is, or a ``ParallelEnv`` with those of all."""
    if isinstance(env, AECEnv):
        env.step(*actions.values())
        return _next_turn(env, env.rewards)
    observations, rewards, terminations, truncations, infos = env.step(actions)
    taking_part = list(dict.fromkeys([*actions, *env.agents]))  # the second hold those who joined
    ended = [agent for agent in taking_part if agent not in env.agents]
    return Position(
        list(env.agents),
        {agent: (observations[agent], infos.get(agent, {})) for agent in taking_part if agent in observations},
        {agent: _number(rewards[agent]) for agent in taking_part if agent in rewards},
        {agent: bool(terminations.get(agent)) for agent in ended},
        # One that is gone without either flag was cut off.
        {agent: bool(truncations.get(agent) or not terminations.get(agent)) for agent in ended},
    )


def look(env: Any, agent: str) -> dict[str, tuple[Any, Info]]:
    """Return what an agent sees now, if it is one of an ``AECEnv`` that has not ended, whose turn it may not be."""
    return {agent: (env.observe(agent), env.infos[agent])} if isinstance(env, AECEnv) and agent in env.agents else {}


def _next_turn(env: Any, rewards: dict[str, Any]) -> Position:
    """Take out the agents that ended, by the step with None that PettingZoo asks for, and return whose turn it is.

    The rewards are those of the step before: PettingZoo's ``last()`` gives their sum when the agent's turn comes.
    """
    position = Position([], {}, {agent: _number(reward) for agent, reward in rewards.items()}, {}, {})
    while env.agents and not position.acting:
        agent = env.agent_selection
        observation, _, terminated, truncated, info = env.last()
        position.seen[agent] = (observation, info)
        if terminated or truncated:
            position.terminations[agent], position.truncations[agent] = bool(terminated), bool(truncated)
            env.step(None)
        else:
            position.acting.append(agent)
    return position


def _number(reward: Any) -> float:
    """Return a reward as a number; PettingZoo also takes an array of one."""
    return float(np.asarray(reward).item())
