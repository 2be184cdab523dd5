"""Checks of what passes between several agents and their environment: actions, verdicts, names of seats."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gem_core.env.results import checked_reward
from gem_core.errors import ArgumentError, ResetNeededError
from gem_core.suggestions import did_you_mean
from gem_core.types import Info, Observation

Verdict = tuple[Mapping[str, float], Mapping[str, bool], Mapping[str, bool], Mapping[str, Info]]
"""``(rewards, terminations, truncations, infos)``; one left out gets 0.0, False, False and an empty info."""

_MAPPING = dict, Mapping
"""Nearly all are dictionaries, and for those the abstract class, which is slow, is not asked."""


def named(agents: Iterable[str]) -> str:
    """Return names for an error."""
    return ", ".join(map(repr, agents))


def check_in_episode(name: str, live: bool) -> None:
    """Refuse a step outside an episode.

    Args:
        name: What errors call the environment.
        live: Whether an episode is under way.

    Raises:
        ResetNeededError: None is.
    """
    if not live:
        raise ResetNeededError(f"{name}: the episode is over or has not begun; call reset() before the next step()")


def check_actions(name: str, acting: Sequence[str], actions: Mapping[str, str]) -> None:
    """Refuse what is not one action of each agent that acts now, and of no other.

    Args:
        name: What errors call the environment.
        acting: Who has to act now.
        actions: What was given to ``step``.

    Raises:
        ArgumentError: An action is missing, is of an agent that does not act now, or is no text.
        ResetNeededError: Nobody acts.
    """
    check_in_episode(name, bool(acting))
    if not isinstance(actions, _MAPPING):
        raise ArgumentError(f"actions are {{agent: response}}, here of {named(acting)}, not {actions!r:.100}")
    for agent in acting:
        if agent not in actions:
            raise ArgumentError(f"the action of {agent!r} is missing; {_who_acts(acting)}")
    for agent, action in actions.items():
        if agent not in acting:
            raise ArgumentError(f"there is an action of {agent!r}, which does not act now; {_who_acts(acting)}")
        if not isinstance(action, str):
            raise ArgumentError(
                f"an action is a str or a Response, and that of {agent!r} is {action!r:.100} of type "
                f"{type(action).__name__}"
            )


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
        raise ValueError(
            f"{name}: begin_episode must leave some of {named(possible)} in self.agents, not {agents!r:.200}"
        )
    if told is None:
        return {}
    if not isinstance(told, Mapping) or not all(isinstance(info, dict) for info in told.values()):
        raise TypeError(f"{name}: begin_episode must return {{agent: info}} or None, not {told!r:.200}")
    for agent in told:
        if agent not in agents:
            raise ValueError(f"{name}: begin_episode has an info for {agent!r}, and {named(agents)} take part")
    return told


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
    if not parts or not all([isinstance(part, _MAPPING) for part in parts]):
        raise TypeError(
            f"{name}: process_actions must return (rewards, terminations, truncations, infos), not {result!r:.200}"
        )
    rewards, terminations, truncations, infos = parts
    for agent in {**rewards, **terminations, **truncations, **infos}:
        if agent not in agents:
            raise ValueError(f"{name}: process_actions names {agent!r}, and {named(agents)} take part")
    for agent, info in infos.items():
        if not isinstance(info, dict):
            raise TypeError(f"{name}: the info of {agent!r} must be a dictionary, not {type(info).__name__}")
    return (
        {agent: checked_reward(reward, f"{name}: the reward of {agent!r}") for agent, reward in rewards.items()},
        {agent: bool(flag) for agent, flag in terminations.items()},
        {agent: bool(flag) for agent, flag in truncations.items()},
        dict(infos),
    )


def checked_observation(name: str, agent: str, observation: object) -> Observation:
    """Return an observation, if it is one.

    Raises:
        TypeError: It is neither text nor a list.
    """
    if not isinstance(observation, str | list):
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


def _who_acts(acting: Sequence[str]) -> str:
    return f"{named(acting)} {'acts' if len(acting) == 1 else 'act'} now"
