"""Checks of what passes between environments and their callers: results, actions, names of seats."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NoReturn, cast

import numpy as np

from gem_core.errors import ArgumentError, ResetNeededError
from gem_core.suggestions import did_you_mean
from gem_core.types import Info, Observation, ResetResult, StepResult

Verdict = tuple[Mapping[str, float], Mapping[str, bool], Mapping[str, bool], Mapping[str, Info]]
"""``(rewards, terminations, truncations, infos)``; one left out gets 0.0, False, False and an empty info."""

_OBSERVATIONS = (str, list)
_FLAGS = (bool, np.bool_, int, np.integer)


def checked_result(result: object, whose: str = "") -> StepResult:
    """Validate the result of ``step``, and copy its info, which the environment may change later.

    Args:
        result: What was returned.
        whose: Begins an error, as ``"MyEnv: "``.

    Raises:
        TypeError: It is not five values, or a value has a wrong type.
        ValueError: The reward is not finite.
    """
    if not isinstance(result, tuple) or len(result) != 5:
        raise TypeError(f"{whose}step must return five values, from observation to info, not {result!r:.200}")
    observation, reward, terminated, truncated, info = result
    if type(reward) is not float or not math.isfinite(reward):
        reward = checked_reward(reward, f"{whose}the reward")
    if not isinstance(observation, _OBSERVATIONS) or not isinstance(info, dict):
        _refuse_types(observation, info, whose)
    if type(terminated) is not bool or type(truncated) is not bool:
        terminated = _checked_flag(terminated, f"{whose}terminated")
        truncated = _checked_flag(truncated, f"{whose}truncated")
    return observation, reward, terminated, truncated, info.copy()


def checked_reset(result: object, whose: str = "") -> ResetResult:
    """Validate the result of ``reset``, and copy its info; see ``checked_result``.

    Raises:
        TypeError: It is not two values, or a value has a wrong type.
    """
    if not isinstance(result, tuple) or len(result) != 2:
        raise TypeError(f"{whose}reset must return (observation, info), not {result!r:.200}")
    observation, info = result
    if not isinstance(observation, _OBSERVATIONS) or not isinstance(info, dict):
        _refuse_types(observation, info, whose)
    return observation, info.copy()


def _refuse_types(observation: object, info: object, whose: str) -> NoReturn:
    if not isinstance(observation, _OBSERVATIONS):
        raise TypeError(f"{whose}an observation must be text or a list, not {type(observation).__name__}")
    raise TypeError(f"{whose}info must be a dictionary, not {type(info).__name__}")


def _checked_flag(flag: Any, whose: str) -> bool:
    if not isinstance(flag, _FLAGS) or flag not in (0, 1):  # any object has a truth value
        raise TypeError(f"{whose} must be True or False, not {flag!r:.200}")
    return bool(flag)


def checked_reward(reward: Any, whose: str) -> float:
    """Return a reward as a number.

    Raises:
        TypeError: It is none.
        ValueError: It is not finite.
    """
    try:
        number = math.nan if isinstance(reward, str | bytes) else float(reward)
    except (TypeError, ValueError, OverflowError) as error:
        raise TypeError(f"{whose} must be a finite number, not {reward!r:.200}") from error
    if not math.isfinite(number):
        raise ValueError(f"{whose} must be a finite number, not {reward!r:.200}")
    return number


def refuse_action(action: object, whose: str = "") -> NoReturn:
    """Raise the error of an action that is no text.

    Args:
        action: What was given.
        whose: Ends the error, as ``" of 'white'"``.

    Raises:
        ArgumentError: Always.
    """
    raise ArgumentError(f"an action{whose} is a str or a Response, not {action!r:.100} of type {type(action).__name__}")


def reset_needed(env: Any) -> ResetNeededError:
    """Return the error of a step outside an episode."""
    name = env.env_id or type(env.unwrapped).__name__
    return ResetNeededError(f"{name}: the episode is over or has not begun; call reset() before the next step()")


# Several agents.


def named(agents: Iterable[str]) -> str:
    """Return names for an error."""
    return ", ".join(map(repr, agents))


def check_actions(acting: Collection[str], actions: Mapping[str, str], where: str = "") -> None:
    """Refuse what is not one action of each agent that acts now, and of no other.

    Args:
        acting: Who has to act now.
        actions: What was given to ``step``.
        where: Place for an error, as ``" in slot 3"``.

    Raises:
        ArgumentError: An action is missing, is of an agent that does not act now, or is no text.
    """
    if not isinstance(actions, Mapping):
        raise ArgumentError(f"actions{where} are {{agent: response}}, here of {named(acting)}, not {actions!r:.100}")
    for agent in (*acting, *actions):
        if agent not in actions or agent not in acting:
            problem = "is missing" if agent in acting else "is not wanted"
            raise ArgumentError(f"the action of {agent!r}{where} {problem}: {named(acting)} must act, and nobody else")
        if not isinstance(actions[agent], str):
            refuse_action(actions[agent], f" of {agent!r}{where}")


def checked_beginning(name: str, possible: Sequence[str], agents: Sequence[str], told: Any) -> Mapping[str, Info]:
    """Return the infos of ``begin_episode``, if they and the agents that it left are well-formed.

    Args:
        name: What errors call the environment.
        possible: Its ``possible_agents``.
        agents: Those who take part.
        told: What ``begin_episode`` returned.

    Raises:
        TypeError: It returned something else.
        ValueError: Nobody takes part, or somebody who is no possible agent; or an info is for nobody who does.
    """
    if not agents or not set(agents) <= set(possible):
        raise ValueError(f"{name}: begin_episode must leave some of {named(possible)} in agents, not {agents!r:.200}")
    told = {} if told is None else told
    _check_infos(f"{name}: begin_episode", told, agents)
    return cast("Mapping[str, Info]", told)


def checked_verdict(
    name: str, agents: Sequence[str], result: object
) -> tuple[dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]]:
    """Return what ``process_actions`` returned, if it is well-formed.

    Args:
        name: What errors call the environment.
        agents: Those who take part.
        result: What was returned.

    Raises:
        TypeError: It is not four or five dictionaries, or a value has a wrong type.
        ValueError: A reward is not finite, or is for an agent that does not take part.
    """
    parts = result[-4:] if isinstance(result, tuple) and len(result) in (4, 5) else ()
    if not parts or not all(isinstance(part, Mapping) for part in parts):
        raise TypeError(
            f"{name}: process_actions must return four mappings, from rewards to infos, not {result!r:.200}"
        )
    rewards, terminations, truncations, infos = parts
    _check_infos(f"{name}: process_actions", infos, agents)
    _check_taking_part(f"{name}: process_actions", (*rewards, *terminations, *truncations), agents)
    return (
        {agent: checked_reward(reward, f"{name}: the reward of {agent!r}") for agent, reward in rewards.items()},
        {agent: bool(flag) for agent, flag in terminations.items()},
        {agent: bool(flag) for agent, flag in truncations.items()},
        dict(infos),
    )


def _check_infos(whose: str, infos: object, agents: Sequence[str]) -> None:
    if not isinstance(infos, Mapping) or not all(isinstance(info, dict) for info in infos.values()):
        raise TypeError(f"{whose} must give infos as {{agent: info}}, not {infos!r:.200}")
    _check_taking_part(whose, infos, agents)


def _check_taking_part(whose: str, given: Iterable[str], agents: Sequence[str]) -> None:
    for agent in given:
        if agent not in agents:
            raise ValueError(f"{whose} names {agent!r}, and {named(agents)} take part")


def checked_observation(name: str, agent: str, observation: object) -> Observation:
    """Return an observation, if it is one.

    Raises:
        TypeError: It is neither text nor a list.
    """
    if not isinstance(observation, _OBSERVATIONS):
        raise TypeError(f"{name}: an observation must be text or a list, and that of {agent!r} is {observation!r:.100}")
    return observation


def check_seats(given: Iterable[str], seats: Sequence[str]) -> None:
    """Raise an error for a name that is no seat.

    Args:
        given: What is checked.
        seats: The ``possible_agents`` of an environment.

    Raises:
        ArgumentError: Names the seats that there are.
    """
    for name in given:
        if name not in seats:
            hint = did_you_mean(str(name), seats)
            raise ArgumentError(f"there is no seat {name!r}.{hint} The seats are: {named(seats)}")
