"""``JointEpisode``: the record of an episode in which several agents acted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from gem_core.errors import EpisodeFileError
from gem_core.records.episode import SCHEMA_VERSION, Episode, Transition, same_record
from gem_core.records.plain_json import ImageFolder

_SHARED = ("id", "seed", "kwargs", "options", "group", "key", "repeat", "run_seed", "versions")
"""Fields that the episode of every seat has in common with the joint one."""

_OF_START = (*_SHARED, "wrappers")


@dataclass(eq=False)
class JointEpisode:
    """The record of one episode of several agents: an ``Episode`` for each seat, and who acted when.

    It is iterated over as its episodes, one for each seat that was shown something. An episode of a seat holds the
    turns of that seat alone; the reward of a turn is what the seat earned until it acted again.

    Args:
        id: Id of the environment, or the name of its class.
        seed: Seed of the episode.
        seats: The episode of each seat, in the order of the environment's ``possible_agents``.
        agents: Name of the agent at each seat, also if the reset failed.
        order: Who acted in each step, in the order of the steps.
        failure: An error that is in the episode of no seat, as that of a reset; None for none.
        kwargs: Keyword arguments of the environment over the registered ones.
        wrappers: Names and options of its wrappers, innermost first: one list for all seats, or one for each by name.
        options: The options of ``reset``.
        group: Shared by episodes that started alike.
        key: The item's place in the plan.
        repeat: Which of the item's episodes it is, from 0.
        run_seed: Seed of the run.
        versions: Version of each distribution that took part.
        schema_version: Version of this record's form.
    """

    id: str
    seed: int | None
    seats: dict[str, Episode] = field(default_factory=dict)
    agents: dict[str, str] = field(default_factory=dict)
    order: list[list[str]] = field(default_factory=list)
    failure: dict[str, Any] | None = None
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    wrappers: list[Any] | dict[str, list[Any]] = field(default_factory=list)
    options: Mapping[str, Any] | None = None
    group: str | None = None
    key: str = "0"
    repeat: int = 0
    run_seed: int | None = None
    versions: dict[str, str] = field(default_factory=dict)
    schema_version: int = SCHEMA_VERSION

    def wrappers_of(self, seat: str) -> list[Any]:
        """Return the wrappers of a seat."""
        return self.wrappers.get(seat, []) if isinstance(self.wrappers, dict) else self.wrappers

    def __iter__(self) -> Iterator[Episode]:
        """Iterate over the episodes of the seats."""
        return iter(self.seats.values())

    @property
    def returns(self) -> dict[str, float]:
        """The sum of each seat's rewards, undiscounted."""
        return {seat: episode.episode_return for seat, episode in self.seats.items()}

    @property
    def turns(self) -> int:
        """Number of steps of the environment."""
        return len(self.order)

    @property
    def error(self) -> dict[str, Any] | None:
        """The failure of the environment or a server, not of an agent; None for an episode that counts.

        Errors of the kind ``"opponent"``, of seats that were cut off since another had no answer, are left out.
        """
        errors = (episode.error for episode in self.seats.values())
        own = (error for error in errors if error is not None and error.get("kind") != "opponent")
        return self.failure or next(own, None)

    def transcript(self) -> Iterator[tuple[str, Transition]]:
        """Yield the turns of all seats, each with its seat, in the order in which they acted."""
        turns = {seat: iter(episode.transitions) for seat, episode in self.seats.items()}
        for acted in self.order:
            for seat in acted:
                turn = next(turns[seat], None)
                if turn is not None:
                    yield seat, turn

    def to_dict(self, images: ImageFolder | None = None) -> dict[str, Any]:
        """Return the record as plain JSON; what all seats have in common is written once.

        Args:
            images: The folder for images; None leaves their content out.
        """
        start = Episode(observation="", info={}, **{name: getattr(self, name) for name in _OF_START})
        shared = {name: value for name, value in start.to_dict(images).items() if name in _OF_START}
        return {
            **shared,
            "agents": dict(self.agents),
            "order": [list(acted) for acted in self.order],
            "failure": self.failure,
            "schema_version": self.schema_version,
            "seats": {
                seat: {name: value for name, value in episode.to_dict(images).items() if name not in _SHARED}
                for seat, episode in self.seats.items()
            },
        }

    @classmethod
    def from_dict(cls, record: Mapping[str, Any], images: ImageFolder | None = None) -> JointEpisode:
        """Return the record that ``to_dict`` wrote.

        Raises:
            EpisodeFileError: It is no record of a joint episode, or of a later form than this version reads.
        """
        try:
            shared = {name: record[name] for name in _SHARED}
            empty = {"observation": "", "info": {}, "transitions": []}
            started = {**shared, **empty, "wrappers": record["wrappers"], "schema_version": record["schema_version"]}
            start = Episode.from_dict(started, images)
            seats = {seat: Episode.from_dict({**shared, **each}, images) for seat, each in record["seats"].items()}
            order = [list(map(str, acted)) for acted in record["order"]]
            if not seats.keys() >= set().union(*order):
                raise ValueError("the order names a seat without an episode")
            agents = {seat: str(agent) for seat, agent in record["agents"].items()}
            common = {name: getattr(start, name) for name in _OF_START}
            return cls(seats=seats, agents=agents, order=order, failure=record["failure"], **common)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise EpisodeFileError(f"the record of an episode is damaged ({type(error).__name__}: {error})") from error

    def __eq__(self, other: object) -> bool:
        """Compare all but durations (``info["episode"]["t"]``) and the run that it belongs to."""
        return same_record(self.to_dict(), other.to_dict()) if isinstance(other, JointEpisode) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # records are mutable


Record = Episode | JointEpisode
"""The record of an episode of one agent, or of several."""


def record_from_dict(record: Any, images: ImageFolder | None = None) -> Record:
    """Return the episode, of one agent or of several, that ``to_dict`` wrote.

    Raises:
        EpisodeFileError: It is neither, or of a later form than this version reads.
    """
    joint = isinstance(record, Mapping) and "seats" in record
    return JointEpisode.from_dict(record, images) if joint else Episode.from_dict(record, images)
