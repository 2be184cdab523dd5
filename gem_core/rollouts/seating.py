"""Which agent plays an episode, alone or at which seat: fixed, self-play, rotating over the seats, or a league."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from gem_core.env.seeding import stable_hash
from gem_core.errors import ArgumentError
from gem_core.records.plans import EpisodeStart
from gem_core.rollouts.agent import Agent, as_agent, load_agent


class Seated(NamedTuple):
    """An agent at a seat.

    Args:
        name: What records call it.
        agent: It is called with an observation and a context.
    """

    name: str
    agent: Agent


ALONE = "agent"
"""The seat of an agent that is alone in its environment."""


class Seating(ABC):
    """Decides which agents act in each episode; a subclass is taken as the ``agents`` of ``rollout``."""

    is_alone: ClassVar[bool] = False
    """Whether it is for environments of one agent."""

    loaded: tuple[Agent, ...] = ()
    """Agents that were given by name, which ``rollout`` closes at its end."""

    def _seated(self, agent: Any) -> Seated:
        """Return ``seated(agent)``, and remember it if it was loaded here."""
        one = seated(agent)
        if isinstance(agent, str):
            self.loaded = (*self.loaded, one.agent)
        return one

    @abstractmethod
    def agents(self) -> Iterable[Agent]:
        """Return every agent that may act, to be prepared before the first episode."""

    @abstractmethod
    def seat(self, seats: Sequence[str], start: EpisodeStart) -> Mapping[str, Seated]:
        """Return the agent at each seat of an episode.

        Args:
            seats: The environment's ``possible_agents``.
            start: What the episode starts from; the same start gives the same agents.

        Raises:
            ArgumentError: The agents do not fit the seats.
        """


class OneAgent(Seating):
    """The same agent in every episode of environments of one agent."""

    is_alone = True

    def __init__(self, agent: Any) -> None:
        self._agent = self._seated(agent)

    def agents(self) -> Iterable[Agent]:
        """Return the agent."""
        return [self._agent.agent]

    def seat(self, seats: Sequence[str], start: EpisodeStart) -> Mapping[str, Seated]:
        """Return the agent."""
        return {ALONE: self._agent}


class AgentOfItem(Seating):
    """The agent that each item of the plan names, in environments of one agent.

    Args:
        agents: ``{name: agent}``.
    """

    is_alone = True

    def __init__(self, agents: Mapping[str, Any]) -> None:
        self._agents = {name: Seated(name, self._seated(agent).agent) for name, agent in agents.items()}

    def agents(self) -> Iterable[Agent]:
        """Return the agents."""
        return [each.agent for each in self._agents.values()]

    def seat(self, seats: Sequence[str], start: EpisodeStart) -> Mapping[str, Seated]:
        """Return the agent of the item."""
        name = start.item.agent
        if name is None or name not in self._agents:
            raise ArgumentError(
                f"an item of the plan has agent={name!r}, and the agents given are {_named(self._agents)}"
            )
        return {ALONE: self._agents[name]}


class NamedSeats(Seating):
    """Each agent has the seat that it was named for, moved on by the item's ``rotation``.

    Args:
        agents: ``{seat: agent}``.
    """

    def __init__(self, agents: Mapping[str, Any]) -> None:
        self._agents = {seat: self._seated(agent) for seat, agent in agents.items()}

    def agents(self) -> Iterable[Agent]:
        """Return the agents."""
        return [each.agent for each in self._agents.values()]

    def seat(self, seats: Sequence[str], start: EpisodeStart) -> Mapping[str, Seated]:
        """Return the agents by seat."""
        if sorted(seats) != sorted(self._agents):
            raise ArgumentError(f"the seats are {_named(seats)}, and agents are given for {_named(self._agents)}")
        return _rotated(seats, [self._agents[seat] for seat in seats], start, 0)


class RotatingSeats(Seating):
    """As many agents as seats, which move on by one seat from item to item of the plan; or one agent at every seat.

    Each is as often at each seat as any other, but for the last episodes of a run.

    Args:
        agents: The agents, first those of the first item.
    """

    def __init__(self, agents: Sequence[Any]) -> None:
        self._agents = [self._seated(agent) for agent in agents]

    def agents(self) -> Iterable[Agent]:
        """Return the agents."""
        return [each.agent for each in self._agents]

    def seat(self, seats: Sequence[str], start: EpisodeStart) -> Mapping[str, Seated]:
        """Return the agents by seat."""
        agents = self._agents * len(seats) if len(self._agents) == 1 else self._agents
        if len(agents) != len(seats):
            raise ArgumentError(f"the {len(seats)} seats are {_named(seats)}, and {len(agents)} agents are given")
        return _rotated(seats, agents, start, start.number)


class League(Seating):
    """A learner, which changes seats from item to item, against opponents that are drawn for each item of the plan.

    The opponents are a pool that may grow: ``add`` a past self of the learner now and then. Agents that are given by
    name are closed at the end of each run, and prepared again at the beginning of the next. The repeats of an item, as
    those of a group, meet the same opponents. The same run seed and pool give the same ones.

    Args:
        learner: The agent that is trained.
        opponents: Other agents by name.
        weights: Relative frequency of each opponent; 1 for opponents that are not named.
        latest: Weight of the learner itself, as it is now, among the opponents. In records it is called ``"latest"``.
        name: What records call the learner at its own seat.

    Raises:
        ArgumentError: A weight is negative or of an unknown opponent, or all are 0.

    Source: fictitious self-play against a pool of past selves, arXiv:1603.01121.
    """

    LATEST = "latest"

    def __init__(
        self,
        learner: Any,
        opponents: Mapping[str, Any] | None = None,
        *,
        weights: Mapping[str, float] | None = None,
        latest: float = 1.0,
        name: str = "learner",
    ) -> None:
        self._learner = Seated(name, self._seated(learner).agent)
        self._pool: dict[str, tuple[Seated, float]] = {}
        self._put(Seated(self.LATEST, self._learner.agent), latest)
        weights = dict(weights or {})
        for each, agent in (opponents or {}).items():
            self._put(Seated(each, self._seated(agent).agent), weights.pop(each, 1.0))
        if weights:
            raise ArgumentError(f"weights names {_named(weights)}, and the opponents are {_named(opponents or {})}")
        self._check_weights()

    def add(self, name: str, agent: Any, *, weight: float = 1.0) -> None:
        """Take an agent into the pool of opponents, or give one of that name another agent and weight.

        It takes part in the episodes that begin from now on.

        Raises:
            ArgumentError: Its weight is negative, or all are 0.
        """
        self._put(Seated(name, self._seated(agent).agent), weight)
        self._check_weights()

    def _put(self, one: Seated, weight: float) -> None:
        if not 0 <= weight < float("inf"):
            raise ArgumentError(f"the weight of {one.name!r} must be a number from 0 up, not {weight!r}")
        self._pool[one.name] = one, weight

    def _check_weights(self) -> None:
        if not any(weight for _, weight in self._pool.values()):
            raise ArgumentError("a league needs an opponent whose weight is above 0; the learner's own is 'latest'")

    def agents(self) -> Iterable[Agent]:
        """Return the learner and the pool."""
        return [one.agent for one, _ in self._pool.values()]

    def seat(self, seats: Sequence[str], start: EpisodeStart) -> Mapping[str, Seated]:
        """Return the learner at its seat, and opponents at the others."""
        draws = np.random.default_rng(stable_hash(start.run_seed, "league", *start.place))
        pool = list(self._pool.values())
        weights = np.array([weight for _, weight in pool])
        drawn = draws.choice(len(pool), size=len(seats) - 1, p=weights / weights.sum())
        agents = [self._learner, *(pool[int(place)][0] for place in drawn)]
        return _rotated(seats, agents, start, start.number)


def as_seating(agents: Any) -> Seating:
    """Return what decides the seats, for anything that ``rollout`` takes as ``agents``.

    Raises:
        AgentError: Something in it is no agent.
        ArgumentError: There is no agent.
    """
    if isinstance(agents, Seating):
        return agents
    if isinstance(agents, Mapping | list | tuple) and not isinstance(agents, Seated):
        if not agents:
            raise ArgumentError("agents names no agent; give {seat: agent}, a list of agents, or one for all seats")
        return NamedSeats(agents) if isinstance(agents, Mapping) else RotatingSeats(agents)
    return RotatingSeats([agents])


def seated(agent: Any) -> Seated:
    """Return an agent with a name: the one that it is loaded by, its own ``name``, or that of its function or class."""
    if isinstance(agent, str):
        return Seated(agent, load_agent(agent))
    if isinstance(agent, Seated):
        return Seated(agent.name, as_agent(agent.agent))
    own = getattr(agent, "name", None) or getattr(agent, "__name__", None)
    return Seated(own if isinstance(own, str) else type(agent).__name__, as_agent(agent))


def _rotated(seats: Sequence[str], agents: Sequence[Seated], start: EpisodeStart, places: int) -> dict[str, Seated]:
    """Return agents by seat, moved on by the item's ``rotation``, or by some places if it has none."""
    places = places if start.item.rotation is None else start.item.rotation
    return {seat: agents[(number - places) % len(seats)] for number, seat in enumerate(seats)}


def _named(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names)) or "none"
