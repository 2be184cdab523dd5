"""The present episode of a slot: which agents are asked, what is stepped, and the record that is made of it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, cast

from gem_core.errors import ArgumentError
from gem_core.records.joint import JointEpisode
from gem_core.records.plans import EpisodeStart
from gem_core.rollouts.agent import Agent, Reading
from gem_core.rollouts.seat import RunningSeat, common_fields, new_episode
from gem_core.rollouts.seating import Seated, Seating
from gem_core.types import TERMINAL_STATE, Action, Info, Observation, Response
from gem_core.vector.vector_env import VectorEnv

Question = tuple[str, Agent, RunningSeat]
"""The seat that is asked (``""`` for an agent alone), its agent, and its episode so far."""


class SoloEpisode:
    """An episode of one agent that begins in a slot.

    Args:
        vector: Where it runs.
        slot: Number of the slot.
        start: What it starts from.
        observation: What the slot was reset to.
        info: The info of that reset.
        one: Who acts.

    Raises:
        ArgumentError: Several agents act in the environment.
    """

    def __init__(
        self, vector: VectorEnv, slot: int, start: EpisodeStart, observation: Observation, info: Info, one: Seated
    ) -> None:
        described = vector.describe(slot)
        if "possible_agents" in info:
            seats = ", ".join(map(repr, info["possible_agents"]))
            raise ArgumentError(
                f"{described['id']} has several seats, {seats}: give agents={{seat: agent}}, a list of agents that "
                f"change seats, or agents=AGENT for self-play; for 'gem run', register it with seats=({seats})"
            )
        self.slot = slot
        self.record = new_episode(described, start, observation, info)
        self.record.agent = one.name
        self._seat = RunningSeat(self.record, Reading.of(one.agent), partial(vector.sample_random_action, slot))
        self._questions: list[Question] = [("", one.agent, self._seat)]

    def questions(self) -> list[Question]:
        """Return whom to ask about the last result."""
        return self._questions

    def answer(self, seat: str, response: Response) -> Action:
        """Take the agent's response; return the action to step."""
        self._seat.response = response
        return response

    def add(self, reward: Any, terminated: bool, truncated: bool, observation: Any, info: Info) -> None:
        """Take the result of the step."""
        self._seat.add(reward, terminated, truncated, observation, info)

    def cut_off(self, seat: str, reported: Info) -> None:
        """End the episode between two steps, since the agent has no answer for the reason reported."""
        self._seat.cut_off(reported)


class SharedEpisode:
    """An episode of several agents, each at its seat, that begins in a slot.

    Args:
        vector: Where it runs.
        slot: Number of the slot.
        start: What it starts from.
        observations: What the slot was reset to, by seat.
        info: The info of that reset.
        seating: Says which agent has which seat.

    Raises:
        ArgumentError: One agent acts in the environment, or the agents do not fit its seats.
    """

    def __init__(
        self, vector: VectorEnv, slot: int, start: EpisodeStart, observations: Any, info: Info, seating: Seating
    ) -> None:
        described = vector.describe(slot)
        if "possible_agents" not in info:
            raise ArgumentError(f"{described['id']} is for one agent: give agent, not agents")
        self._seated = seating.seat(info["possible_agents"], start)
        names = {seat: one.name for seat, one in self._seated.items()}
        self.slot = slot
        self.record = JointEpisode(**common_fields(described, start), agents=names)
        self._vector = vector
        self._start = start
        self._running: dict[str, RunningSeat] = {}
        self._ended: set[str] = set()
        self._acting = list(observations)
        self._responses: dict[str, Response] = {}
        for seat, observation in observations.items():
            self._first_seen(seat, observation, 0.0, info["agents"][seat])

    def questions(self) -> list[Question]:
        """Return those who act now."""
        return [(seat, self._seated[seat].agent, self._running[seat]) for seat in self._acting]

    def answer(self, seat: str, response: Response) -> Action | None:
        """Take a response; return all of them once everybody who acts has given one."""
        self._running[seat].response = self._responses[seat] = response
        if len(self._responses) < len(self._acting):
            return None
        actions = {each: self._responses[each] for each in self._acting}
        self.record.order.append(list(actions))
        self._responses = {}
        return cast("Action", actions)

    def add(self, reward: Any, terminated: bool, truncated: bool, observation: Any, info: Info) -> None:
        """Add a turn for everybody who acts again or has ended; of a step that failed, for all whose turn was open."""
        if "error" in info and not info["agents"]:
            self._lose(info)
            return
        self._acting = list(observation)
        for seat, own in info["agents"].items():
            seen = observation[seat] if seat in observation else own["final_obs"]
            own = {name: value for name, value in own.items() if name != "final_obs"}
            running = self._running.get(seat)
            if running is None:
                self._first_seen(seat, seen, reward[seat], own)
                self._running[seat].episode.ended_first = info["terminations"][seat]
            else:
                running.add(reward[seat], info["terminations"][seat], info["truncations"][seat], seen, own)
            if info["terminations"][seat] or info["truncations"][seat]:
                self._ended.add(seat)
        if "error" in info:
            self._leave_out([seat for seat in info["agents"] if info["truncations"][seat]])

    def cut_off(self, seat: str, reported: Info) -> None:
        """End the episode for everybody; the others could not finish it, and do not count."""
        for each, running in self._running.items():
            if each == seat:
                running.cut_off(reported)
            elif each not in self._ended:
                running.cut_off({"error": {"kind": "opponent", "message": f"the agent at {seat!r} has no answer"}})

    def _leave_out(self, seats: Sequence[str]) -> None:
        """Mark those whose episode was cut off by an error at another seat."""
        failed = next((repr(seat) for seat in seats if self._running[seat].episode.error is not None), "another seat")
        for seat in seats:
            if self._running[seat].episode.error is None:
                self._running[seat].cut_off({"error": {"kind": "opponent", "message": f"an error at {failed}"}})

    def _first_seen(self, seat: str, observation: Observation, reward: float, info: Info) -> None:
        """Begin the episode of a seat with the first observation that it is shown."""
        joint, (name, agent) = self.record, self._seated[seat]
        described = {"id": joint.id, "kwargs": joint.kwargs, "wrappers": joint.wrappers_of(seat)}
        episode = new_episode(described, self._start, observation, info)
        episode.seat, episode.agent, episode.first_reward = seat, name, reward
        draw = partial(self._vector.sample_random_action, self.slot, seat)
        self._running[seat] = RunningSeat(episode, Reading.of(agent), draw)
        joint.seats = {each: self._running[each].episode for each in self._seated if each in self._running}

    def _lose(self, info: Info) -> None:
        """End the episode for all who have not ended, since the step failed."""
        self.record.failure = info["error"]
        for seat, running in self._running.items():
            if seat not in self._ended:
                running.add(0.0, False, True, TERMINAL_STATE, {"error": info["error"]})


RunningEpisode = SoloEpisode | SharedEpisode
"""The present episode of a slot."""
