"""The agents of a run, from ``--agent``, alone or at their seats."""

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


class Players(NamedTuple):
    """The agents of a run.

    Args:
        agents: Every agent once, by name.
        options: What ``rollout`` takes: ``agent``, or ``agents`` for several.
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


def load_players(given: Sequence[str], envs: Sequence[EnvSpec], agent_options: Mapping[str, Any]) -> Players:
    """Return the agents that ``--agent`` names, as they act in some environments.

    Args:
        given: The values of ``--agent``.
        envs: The environments of the run.
        agent_options: Keyword arguments for those agents that take them.

    Raises:
        ArgumentError: The agents do not fit the environments.
        UnknownAgentError: There is no such agent.
    """
    from gem_core.rollouts.agent import load_agents
    from gem_core.rollouts.seating import Seated

    matches = [_AT_SEAT.fullmatch(each) for each in given]
    alone = next((env for env in envs if not env.seats), None)
    if not any(env.seats for env in envs):
        if len(given) > 1 or any(matches):
            raise ArgumentError(f"{envs[0].id} is registered without seats, as for one agent: give one --agent AGENT")
        agents = load_agents(given, **agent_options)
        return Players(agents, {"agent": Seated(given[0], agents[given[0]])})
    if alone is not None:
        raise ArgumentError(f"{alone.id} is for one agent, and others have seats: run those of one agent apart")
    by_seat = {match[1]: match[2] for match in matches if match and match[2]}
    for env in envs:
        check_seats(by_seat, env)
        form = f"{env.id} has the seats {', '.join(env.seats)}: write {_form(env.seats)}"
        if any(matches) and (len(by_seat) < len(env.seats) or len(by_seat) < len(given)):
            raise ArgumentError(f"--agent names some seats, and not each once; {form}")
        if not any(matches) and len(given) not in (1, len(env.seats)):
            raise ArgumentError(f"{form}, or one agent for all, or {len(env.seats)} that change seats")
    names = [by_seat[seat] for seat in envs[0].seats] if by_seat else list(given)
    agents = load_agents(names, **agent_options)
    seated = [Seated(name, agents[name]) for name in names]
    return Players(agents, {"agents": dict(zip(envs[0].seats, seated, strict=True)) if by_seat else seated})


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
    if seat in by_seat or (len(by_seat) < len(given) and len(given) > 1):
        raise ArgumentError(
            f"the seat {seat} of {env.id} is yours: give one --agent for all others, or write {_form(others)}"
        )
    all_others = given[0] if given and not by_seat else "random"
    return seat, {each: by_seat.get(each) or all_others for each in others}


def check_seats(seats: Iterable[str], env: EnvSpec) -> None:
    """Raise an error for a seat that an environment does not have; the message names its seats."""
    for seat in seats:
        if seat not in env.seats:
            hint = did_you_mean(seat, env.seats)
            raise ArgumentError(f"{env.id} has no seat {seat!r}.{hint} Its seats are {', '.join(env.seats)}")


def _form(seats: Iterable[str]) -> str:
    return " ".join(f"--agent {seat}=AGENT" for seat in seats)
