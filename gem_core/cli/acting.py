"""Who acts in a run: the agents of ``--agent``, alone or at their seats."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean

if TYPE_CHECKING:
    from gem_core.registry.specs import EnvSpec
    from gem_core.rollouts.agent import Agent

# The name of an agent has no equals sign before its colon.
_AT_SEAT = re.compile(r"([^=:]*)=(.*)", re.DOTALL)


class Acting(NamedTuple):
    """Who acts in a run.

    Args:
        agents: Every agent once, by name.
        options: What ``rollout`` takes: ``agent``, or ``agents`` where several act.
    """

    agents: Mapping[str, Agent]
    options: dict[str, Any]

    @property
    def interactive(self) -> str | None:
        """Name of an agent that answers one episode at a time; None for none."""
        return next((name for name, agent in self.agents.items() if getattr(agent, "interactive", False)), None)


def several_agents(given: Sequence[str]) -> bool:
    """Tell whether the values of ``--agent`` are for several seats, whatever the environment."""
    return len(given) > 1 or any(map(_AT_SEAT.fullmatch, given))


def load_acting(
    given: Sequence[str], envs: Sequence[EnvSpec], agent_options: Mapping[str, Any], *, swap_seats: bool
) -> Acting:
    """Return the agents that ``--agent`` names, as they act in some environments.

    Args:
        given: The values of ``--agent``.
        envs: The environments of the run.
        agent_options: Keyword arguments for those agents that take them.
        swap_seats: Let agents that are given by seat change seats.

    Raises:
        ArgumentError: The agents do not fit the environments.
        UnknownAgentError: There is no such agent.
    """
    from gem_core.rollouts.agent import load_agents
    from gem_core.rollouts.seating import Seated

    if not any(env.seats for env in envs):
        agents = load_agents([_only_agent(given, envs[0].id, swap_seats=swap_seats)], **agent_options)
        return Acting(agents, {"agent": Seated(*next(iter(agents.items())))})
    alone = next((env for env in envs if not env.seats), None)
    if alone is not None:
        several = next(env for env in envs if env.seats)
        raise ArgumentError(
            f"{alone.id} is for one agent, and {_seats_of(several)}: run those of one agent and those of several apart"
        )
    by_seat = _agents_by_seat(given, envs)
    if swap_seats and by_seat is None:
        raise ArgumentError(
            f"--swap-seats goes with agents by seat, as in {_form(envs[0])}; a list changes seats anyway"
        )
    names = list(given) if by_seat is None else [by_seat[seat] for seat in envs[0].seats]
    agents = load_agents(names, **agent_options)
    seated = [Seated(name, agents[name]) for name in names]
    stay = by_seat is not None and not swap_seats
    return Acting(agents, {"agents": dict(zip(envs[0].seats, seated, strict=True)) if stay else seated})


def seats_of_others(given: Sequence[str], seat: str | None, env: EnvSpec) -> tuple[str, dict[str, str]]:
    """Return the seat of a person, and the name of the agent at each other seat.

    Args:
        given: The values of ``--agent``: one for all other seats, or ``SEAT=AGENT`` for some; the rest are random.
        seat: The seat of the person; None for the first.
        env: The environment.

    Raises:
        ArgumentError: They do not fit the seats.
    """
    seat = env.seats[0] if seat is None else seat
    matches = [_AT_SEAT.fullmatch(each) for each in given]
    by_seat = {match[1]: match[2] for match in matches if match is not None}
    check_seats([seat, *by_seat], env)
    others = [each for each in env.seats if each != seat]
    form = " ".join(f"--agent {each}=AGENT" for each in others)
    if seat in by_seat:
        raise ArgumentError(f"the seat {seat} of {env.id} is yours: write {form}, or sit elsewhere by --seat")
    if len(by_seat) < len(given) and len(given) > 1:
        raise ArgumentError(f"give one --agent for all other seats of {env.id}, or one for each: write {form}")
    all_others = given[0] if given and not by_seat else "random"
    return seat, {each: by_seat.get(each) or all_others for each in others}


def _only_agent(given: Sequence[str], env_id: str, *, swap_seats: bool) -> str:
    """Return the name of the agent that acts alone."""
    if swap_seats or len(given) > 1:
        option = "--swap-seats" if swap_seats else "a second --agent"
        raise ArgumentError(
            f"{env_id} is registered without seats, as for one agent: leave {option} out ('gem info ID' names the "
            "seats of others)"
        )
    at_seat = _AT_SEAT.fullmatch(given[0])
    if at_seat is not None:
        raise ArgumentError(
            f"{env_id} is registered without seats, as for one agent: give --agent {at_seat[2] or 'AGENT'}"
        )
    return given[0]


def _agents_by_seat(given: Sequence[str], envs: Sequence[EnvSpec]) -> dict[str, str] | None:
    """Return the name of the agent at each seat; None where they are given without seats.

    Raises:
        ArgumentError: They do not fit the seats.
    """
    matches = [_AT_SEAT.fullmatch(each) for each in given]
    if not any(matches):
        for env in envs:
            if len(given) not in (1, len(env.seats)):
                raise ArgumentError(
                    f"{_seats_of(env)}, and {len(given)} agents are given: give one --agent for all seats, "
                    f"{len(env.seats)} that change seats, or {_form(env)}"
                )
        return None
    by_seat: dict[str, str] = {}
    for each, match in zip(given, matches, strict=True):
        if match is None or not match[2]:
            raise ArgumentError(f"--agent {each} names no {'agent' if match else 'seat'}: write {_form(envs[0])}")
        if match[1] in by_seat:
            raise ArgumentError(f"--agent is given twice for the seat {match[1]}: write {_form(envs[0])}")
        by_seat[match[1]] = match[2]
    for env in envs:
        check_seats(by_seat, env)
        missing = [seat for seat in env.seats if seat not in by_seat]
        if missing:
            raise ArgumentError(f"{_seats_of(env)}, and there is no agent for {', '.join(missing)}: write {_form(env)}")
    return by_seat


def check_seats(seats: Iterable[str], env: EnvSpec) -> None:
    """Raise an error for a seat that an environment does not have, with those that it has."""
    for seat in seats:
        if seat not in env.seats:
            hint = did_you_mean(seat, env.seats)
            raise ArgumentError(f"{env.id} has no seat {seat!r}.{hint} Its seats are {', '.join(env.seats)}")


def _seats_of(env: EnvSpec) -> str:
    return f"{env.id} has the seats {', '.join(env.seats)}"


def _form(env: EnvSpec) -> str:
    return " ".join(f"--agent {seat}=AGENT" for seat in env.seats)
