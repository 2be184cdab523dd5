"""Environments of several agents as the checks play them: an action is of all who act, and so is a result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, cast

import gymnasium

from gem_core.env.guard import Guard
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.env.wrapper import AnyEnv, Wrapper, step_async
from gem_core.testing.findings import shown
from gem_core.types import Action, ResetResult, StepResult
from gem_core.vector.joint import joint_reset, joint_step

_PATIENCE = 200
"""Steps within which an agent has to have its turn."""


class JointView(Wrapper):
    """Gives the results of a ``MultiAgentEnv`` the form that a slot has, so that one check plays all environments."""

    hidden_in_spec = True

    def after_reset(self, result: Any) -> ResetResult:
        """Join the infos."""
        observations, info = joint_reset(cast("MultiAgentEnv", self.env), result)
        seeds = [told.get("seed") for told in info["agents"].values()]
        return observations, {**info, "seed": seeds[0] if seeds else None}

    def step(self, action: Any) -> StepResult:
        """Step, with the responses of those who act."""
        return joint_step(cast("Any", self.env.step(action)))

    async def step_async(self, action: Any) -> StepResult:
        """``step`` for code that runs in an event loop."""
        return joint_step(cast("Any", await step_async(self.env, action)))

    def sample_random_action(self, agent: str | None = None) -> Any:
        """Return a random response of an agent, or by default the action in which each who acts gives one."""
        sample = self.env.get_wrapper_attr("sample_random_action")
        return {each: sample(each) for each in acting(self)} if agent is None else sample(agent)


def layers_of(env: AnyEnv) -> list[AnyEnv]:
    """Return an environment's wrappers and its task, outermost first."""
    layers = [env]
    while isinstance(layers[-1], gymnasium.Wrapper):
        layers.append(layers[-1].env)
    return layers


def guarded(env: AnyEnv) -> AnyEnv:
    """Put a ``Guard`` around a stack that has none, as ``make`` does; around one of several agents, a ``JointView``."""
    if is_joint(env):
        return JointView(env)
    return unchecked(env if any(isinstance(layer, Guard) for layer in layers_of(env)) else Guard(env))


def unchecked(env: AnyEnv) -> AnyEnv:
    """Make the guard of a stack pass results unchecked, since the promises check them."""
    for layer in layers_of(env):
        if isinstance(layer, Guard):
            layer.checks_results = False
    return env


class SeenByOne(NamedTuple):
    """What one agent got from a reset or a step, in the form of an environment of one agent.

    Args:
        where: The call, and whose result it is.
        result: ``(observation, info)``, or ``(observation, reward, terminated, truncated, info)``.
        space: That of the agent's observations.
    """

    where: str
    result: Any
    space: Any


def is_joint(env: AnyEnv) -> bool:
    """Tell whether several agents act in an environment."""
    return isinstance(env.unwrapped, MultiAgentEnv)


def acting(env: AnyEnv) -> tuple[str, ...]:
    """Return who acts now in an environment of several agents."""
    return tuple(env.get_wrapper_attr("acting"))


def seats_of(env: AnyEnv) -> tuple[str, ...]:
    """Return the names of all agents that may take part; one empty name if there is only one."""
    return tuple(env.get_wrapper_attr("possible_agents")) if is_joint(env) else ("",)


def spaces_of(env: AnyEnv, seat: str) -> tuple[Any, Any]:
    """Return the space of an agent's observations, and that of its actions."""
    if not is_joint(env):
        return env.observation_space, env.action_space
    observation_space, action_space = map(env.get_wrapper_attr, ("observation_space", "action_space"))
    return observation_space(seat), action_space(seat)


def say(env: AnyEnv, text: str) -> Action:
    """Return the action in which everyone who acts responds with a text."""
    return dict.fromkeys(acting(env), text) if is_joint(env) else text


def say_as(env: AnyEnv, seat: str, text: str) -> Action:
    """Return the action in which one agent responds with a text, and the others who act at random."""
    if not is_joint(env):
        return text
    return {agent: text if agent == seat else _any_response(env, agent) for agent in acting(env)}


def fitted(env: AnyEnv, action: Action) -> Action:
    """Return an action of another episode for those who act now; an agent without an action there says hello."""
    if not isinstance(action, Mapping) or action.keys() == set(acting(env)):
        return action
    return {agent: action.get(agent, "hello") for agent in acting(env)}


def responses(action: Action) -> Mapping[str, str]:
    """Return the responses of an action by agent; that of the only one under an empty name."""
    return action if isinstance(action, Mapping) else {"": action}


def step_label(action: Action) -> str:
    """Return how a call of ``step`` is named."""
    if not isinstance(action, Mapping):
        return f"step({shown(action)})"
    return f"step({{{', '.join(f'{agent!r}: {shown(text)}' for agent, text in action.items())}}})"


def approach(env: AnyEnv, seat: str, *, over: bool, seed: int) -> bool:
    """Play until it is the turn of an agent, and return whether that comes; one that is alone always acts.

    Args:
        env: As ``guarded`` returned it.
        seat: The agent.
        over: Whether the episode is over, or has not begun.
        seed: Of the first episode that is begun.
    """
    for number in range(_PATIENCE):
        if over:
            env.reset(seed=seed + number)
        if not is_joint(env) or seat in acting(env):
            return True
        result = env.step(say_as(env, "", ""))  # type: ignore[arg-type]  # an action of several agents
        over = bool(result[2] or result[3])
    return False


def split(env: AnyEnv, where: str, result: Any) -> Iterator[SeenByOne]:
    """Yield what each agent got. One that got no observation is left out: the promise ``turns`` tells of it."""
    if not is_joint(env):
        yield SeenByOne(where, result, env.observation_space)
        return
    observations, *middle, info = result
    for agent, told in info["agents"].items():
        given = observations.get(agent, told.get("final_obs") if isinstance(told, Mapping) else None)
        if given is None:
            continue
        flags = [info[name].get(agent, False) for name in ("terminations", "truncations") if middle]
        rewards = [middle[0].get(agent, 0.0)] if middle else []
        yield SeenByOne(f"{where}, for {agent!r},", (given, *rewards, *flags, told), spaces_of(env, agent)[0])


def _any_response(env: AnyEnv, agent: str) -> str:
    try:
        return str(env.get_wrapper_attr("sample_random_action")(agent))
    except Exception:  # noqa: BLE001 - a promise of its own tries and names it
        return "hello"
