"""``SharedEpisode``: an episode of several agents under way, and the records that are made of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from gem_core.records.joint import JointEpisode
from gem_core.records.plans import EpisodeStart
from gem_core.rollouts.agent import Agent, AgentTraits
from gem_core.rollouts.seat import RunningSeat, common_fields, new_episode
from gem_core.rollouts.seating import Seating
from gem_core.types import TERMINAL_STATE, Info, Observation, Response
from gem_core.vector.slot import Slot


class SharedEpisode:
    """An episode of several agents, each at its seat.

    Args:
        slot: The slot that plays it.
        described: ``id``, ``kwargs`` and ``wrappers`` of its environment.
        start: The episode's start.
        observations: The first observations, by seat.
        info: The info of that reset.
        seating: Says which agent has which seat.
    """

    def __init__(
        self,
        slot: Slot,
        described: Mapping[str, Any],
        start: EpisodeStart,
        observations: Any,
        info: Info,
        seating: Seating,
    ) -> None:
        self._seated = seating.seat(info["possible_agents"], start)
        names = {seat: one.name for seat, one in self._seated.items()}
        self.record = JointEpisode(**common_fields(described, start), agents=names)
        self.running: dict[str, RunningSeat] = {}
        """The episode of each seat that was shown something."""
        self.acting = list(observations)
        """Who acts now."""
        self._slot, self._described, self._start = slot, described, start
        self._ended: set[str] = set()
        for seat, observation in observations.items():
            self._first_seen(seat, observation, 0.0, info["agents"][seat])

    def agent_at(self, seat: str) -> Agent:
        """Return the agent at a seat."""
        return self._seated[seat].agent

    def take(self, responses: Mapping[str, Response]) -> dict[str, str]:
        """Note the responses of all who act; return the action."""
        self.record.order.append(list(self.acting))
        return dict(responses)

    def add(self, reward: Any, observation: Any, info: Info) -> None:
        """Add a turn for everybody who acts again or has ended; of a step that failed, for all whose turn was open."""
        if "error" in info and not info["agents"]:
            self._lose(info)
            return
        self.acting = list(observation)
        for seat, own in info["agents"].items():
            seen = observation[seat] if seat in observation else own["final_obs"]
            own = {name: value for name, value in own.items() if name != "final_obs"}
            running = self.running.get(seat)
            if running is None:
                self._first_seen(seat, seen, reward[seat], own)
                self.running[seat].episode.ended_first = info["terminations"][seat]
            else:
                running.add(reward[seat], info["terminations"][seat], info["truncations"][seat], seen, own)
            if info["terminations"][seat] or info["truncations"][seat]:
                self._ended.add(seat)
        if "error" in info:
            self._leave_out([seat for seat in info["agents"] if info["truncations"][seat]])

    def cut_off(self, seat: str, reported: Info) -> None:
        """End the episode for everybody; the others could not finish it, and do not count."""
        for each, running in self.running.items():
            if each == seat:
                running.cut_off(reported)
            elif each not in self._ended:
                running.cut_off({"error": {"kind": "opponent", "message": f"the agent at {seat!r} has no answer"}})

    def _leave_out(self, seats: Sequence[str]) -> None:
        """Mark those whose episode was cut off by an error at another seat."""
        failed = next((repr(seat) for seat in seats if self.running[seat].episode.error is not None), "another seat")
        for seat in seats:
            if self.running[seat].episode.error is None:
                self.running[seat].cut_off({"error": {"kind": "opponent", "message": f"an error at {failed}"}})

    def _first_seen(self, seat: str, observation: Observation, reward: float, info: Info) -> None:
        """Begin the episode of a seat with the first observation that it is shown."""
        joint, (name, agent) = self.record, self._seated[seat]
        described = {**self._described, "wrappers": joint.wrappers_of(seat)}
        episode = new_episode(described, self._start, observation, info)
        episode.seat, episode.agent, episode.first_reward = seat, name, reward
        draw = partial(self._slot.sample_random_action, seat)
        self.running[seat] = RunningSeat(episode, AgentTraits.of(agent), draw)
        joint.seats = {each: self.running[each].episode for each in self._seated if each in self.running}

    def _lose(self, info: Info) -> None:
        """End the episode for all who have not ended, since the step failed."""
        self.record.failure = info["error"]
        for seat, running in self.running.items():
            if seat not in self._ended:
                running.add(0.0, False, True, TERMINAL_STATE, {"error": info["error"]})
