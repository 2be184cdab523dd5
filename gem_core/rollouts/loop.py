"""``EpisodeLoop``: sends observations to an agent and its actions to environments. ``drivers`` does the waiting."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from gem_core.errors import ContextOverflowError, EnvFaultError, GemError
from gem_core.records.episode import Episode
from gem_core.records.plans import EpisodeQueue, EpisodeStart, PlanItem
from gem_core.rollouts.agent import Reading
from gem_core.rollouts.requests import AgentRequests
from gem_core.rollouts.seat import RunningSeat, new_episode
from gem_core.types import TERMINAL_STATE, Info, Observation, Response
from gem_core.vector.vector_env import VectorEnv


class EpisodeLoop:
    """Runs episodes in the slots of a vector environment.

    Each slot is stepped as soon as its agent has answered, and its agent is asked as soon as the slot is ready: a slow
    answer or a slow environment delays only its own slot.

    Args:
        vector: Where they run.
        requests: Asks the agent.
        reading: What the agent is to be sent.
    """

    def __init__(self, vector: VectorEnv, requests: AgentRequests, reading: Reading) -> None:
        self._vector = vector
        self._requests = requests
        self._reading = reading
        self._running: dict[int, RunningSeat] = {}
        self._unasked: list[int] = []
        """Slots with an observation that the agent has not been sent."""
        self._finished: list[Episode] = []
        """Episodes that have not been yielded."""

    def run(self, queue: EpisodeQueue) -> Iterator[Episode | None]:
        """Run the episodes of a queue.

        Yields:
            Each episode as it finishes; None where the caller has to wait, until the vector environment has results or
            the agent has replied.
        """
        self._vector.send_reset(queue)
        while self._running or self._vector.under_way:
            if not self._unasked:
                yield None
            try:
                self._advance()
            finally:
                # An error that stops the run is raised after the finished episodes have been yielded.
                while self._finished:
                    yield self._finished.pop(0)

    def _advance(self) -> None:
        """Handle the replies and results that are ready: send actions, and ask the agent about new observations."""
        self._ask()
        responses: dict[int, Response] = {}
        for slot, reply in self._requests.replies():
            if isinstance(reply, Response):
                self._running[slot].response = responses[slot] = reply
            else:
                self._give_up(slot, reply)
        if responses:
            self._vector.send(responses)
        if self._vector.under_way:
            for result in zip(*self._vector.recv(min_envs=0), strict=True):
                self._take(*result)
        # A plain agent answers while it is asked: only after the caller has taken the episodes that have finished.
        if self._requests.asynchronous:
            self._ask()

    def _ask(self) -> None:
        unasked, self._unasked = self._unasked, []
        for slot in unasked:
            running = self._running[slot]
            self._requests.ask(slot, running.conversation.sent(), running.context)

    def _take(
        self, slot: int, observation: Observation, reward: float, terminated: bool, truncated: bool, info: Info
    ) -> None:
        """Handle the result of a reset, a step, or a step with the reset after it."""
        running = self._running.get(slot)
        if running is None:
            self._begin(slot, observation, info)
            return
        over = bool(terminated or truncated)
        next_began = over and self._vector.autoreset == "same_step"
        last = (info.pop("final_obs"), info.pop("final_info")) if next_began else (observation, info)
        running.add(float(reward), bool(terminated), bool(truncated), *last)
        if not over:
            self._unasked.append(slot)
            return
        self._finished.append(self._running.pop(slot).episode)
        if next_began:
            self._begin(slot, observation, info)
        else:
            self._vector.begin_next(slot)

    def _begin(self, slot: int, observation: Observation, info: Info) -> None:
        self._finished += map(_failed_reset, info.pop("failed_resets", ()))
        start = self._vector.start_of(slot)
        if start is not None:
            episode = new_episode(self._vector.describe(slot), start, observation, info)
            draw_action = partial(self._vector.sample_random_action, slot)
            self._running[slot] = RunningSeat(episode, self._reading, draw_action)
            self._unasked.append(slot)

    def _give_up(self, slot: int, failure: GemError) -> None:
        """End an episode because its agent has no answer; a history that is too long for the model is no fault."""
        of_env = isinstance(failure, EnvFaultError)
        if of_env and self._vector.on_error == "raise":
            raise failure
        seat = self._running.pop(slot)
        episode = seat.episode
        error: dict[str, Any] | None = None
        reported: Info = {"context_overflow": True}
        if not isinstance(failure, ContextOverflowError):
            message = str(failure).removeprefix(f"{episode.id}: ")
            error = {"kind": "exception" if of_env else "agent", "message": message}
            reported = {"error": error}
        seat.cut_off(reported)
        self._finished.append(episode)
        self._vector.give_up(slot, error)


def _failed_reset(failed: Mapping[str, Any]) -> Episode:
    """Return the episode of a reset that failed, from what ``info["failed_resets"]`` tells of it."""
    item = PlanItem(options=failed["options"], group=failed["group"])
    place = tuple(map(int, failed["key"].split(".")))
    start = EpisodeStart(item, place, failed["repeat"], failed["seed"], failed["run_seed"])
    info = {"seed": start.seed, "error": failed["error"]}
    if item.group is not None:
        info["group"] = item.group
    return new_episode({"id": failed["id"] or "unknown", "kwargs": failed["kwargs"]}, start, TERMINAL_STATE, info)
