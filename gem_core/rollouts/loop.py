"""``EpisodeLoop``: sends observations to agents and their actions to environments. ``drivers`` does the waiting."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from gem_core.errors import (
    ArgumentError,
    ContextOverflowError,
    EnvFaultError,
    EpisodeLimitError,
    GemError,
    RequestError,
)
from gem_core.failures import author_frames, failure_info
from gem_core.records.joint import JointEpisode, Record
from gem_core.records.plans import EpisodeQueue, EpisodeStart, PlanItem
from gem_core.rollouts.agent import Agent
from gem_core.rollouts.requests import AgentRequests
from gem_core.rollouts.running import RunningEpisode, SharedEpisode, SoloEpisode
from gem_core.rollouts.seat import common_fields, new_episode
from gem_core.rollouts.seating import Seated, Seating
from gem_core.types import TERMINAL_STATE, Action, Info, Observation, Response
from gem_core.vector.vector_env import VectorEnv

Acting = Seated | Mapping[str, Agent] | Seating
"""The agent that acts alone; several by name, of which each item of the plan names one; or who sits where."""


class EpisodeLoop:
    """Runs episodes in the slots of a vector environment.

    Each slot is stepped as soon as its agents have answered, and they are asked as soon as the slot is ready, all who
    act at once: a slow answer or a slow environment delays only its own slot.

    Args:
        vector: Where they run.
        requests: Asks the agents.
        acting: Who acts.
    """

    def __init__(self, vector: VectorEnv, requests: AgentRequests, acting: Acting) -> None:
        self._vector = vector
        self._requests = requests
        self._acting = acting
        self._running: dict[int, RunningEpisode] = {}
        self._unasked: list[int] = []
        """Slots with an observation that the agents have not been sent."""
        self._finished: list[Record] = []
        """Episodes that have not been yielded."""

    def run(self, queue: EpisodeQueue) -> Iterator[Record | None]:
        """Run the episodes of a queue.

        Yields:
            Each episode as it finishes; None where the caller has to wait, until the vector environment has results or
            an agent has replied.
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
        """Handle the replies and results that are ready: send actions, and ask the agents about new observations."""
        self._ask()
        actions: dict[int, Action] = {}
        for (running, seat), reply in self._requests.replies():
            if self._running.get(running.slot) is not running:
                continue  # another seat has just ended the episode
            if isinstance(reply, Response):
                action = running.answer(seat, reply)
                if action is not None:
                    actions[running.slot] = action
            else:
                self._give_up(running, seat, reply)
        if actions:
            self._vector.send(actions)
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
            for seat, agent, seen in running.questions():
                self._requests.ask((running, seat), agent, seen.conversation.sent(), seen.context)

    def _take(
        self, slot: int, observation: Observation, reward: Any, terminated: bool, truncated: bool, info: Info
    ) -> None:
        """Handle the result of a reset, a step, or a step with the reset after it."""
        running = self._running.get(slot)
        if running is None:
            self._begin(slot, observation, info)
            return
        over = bool(terminated or truncated)
        next_began = over and self._vector.autoreset == "same_step"
        last = (info.pop("final_obs"), info.pop("final_info")) if next_began else (observation, info)
        running.add(reward if isinstance(reward, dict) else float(reward), bool(terminated), bool(truncated), *last)
        if not over:
            self._unasked.append(slot)
            return
        self._finished.append(self._running.pop(slot).record)
        if next_began:
            self._begin(slot, observation, info)
        else:
            self._vector.begin_next(slot)

    def _begin(self, slot: int, observation: Observation, info: Info) -> None:
        joint = isinstance(self._acting, Seating)
        alone = self._acting.name if isinstance(self._acting, Seated) else None
        self._finished += [_failed_reset(failed, alone, joint=joint) for failed in info.pop("failed_resets", ())]
        start = self._vector.start_of(slot)
        if start is None:
            return
        if isinstance(self._acting, Seating):
            self._running[slot] = SharedEpisode(self._vector, slot, start, observation, info, self._acting)
        else:
            one = self._acting if isinstance(self._acting, Seated) else _of_item(self._acting, start.item)
            self._running[slot] = SoloEpisode(self._vector, slot, start, observation, info, one)
        self._unasked.append(slot)

    def _give_up(self, running: RunningEpisode, seat: str, failure: GemError) -> None:
        """End an episode because an agent has no answer; a limit that it has reached is no fault."""
        of_env = isinstance(failure, EnvFaultError)
        if of_env and self._vector.on_error == "raise":
            raise failure
        del self._running[running.slot]
        error: dict[str, Any] | None = None
        if isinstance(failure, EpisodeLimitError):
            reported: Info = {"cut_off": failure.limit}
            if isinstance(failure, ContextOverflowError):
                reported["context_overflow"] = True
        else:
            message = str(failure).removeprefix(f"{running.record.id}: ")
            error = failure_info("exception" if of_env else "agent", message, author_frames(failure) if of_env else [])
            if isinstance(failure, RequestError) and failure.cause is not None:
                error["cause"] = failure.cause
            reported = {"error": error}
        running.cut_off(seat, reported)
        self._finished.append(running.record)
        self._vector.give_up(running.slot, error, failure)
        self._requests.forget(running)


def _of_item(agents: Mapping[str, Agent], item: PlanItem) -> Seated:
    """Return the agent that an item of the plan names."""
    if item.agent is None or item.agent not in agents:
        names = ", ".join(map(repr, agents))
        raise ArgumentError(f"an item of the plan has agent={item.agent!r}, and the agents given are {names}")
    return Seated(item.agent, agents[item.agent])


def _failed_reset(failed: Mapping[str, Any], alone: str | None, *, joint: bool) -> Record:
    """Return the episode of a reset that failed, from what ``info["failed_resets"]`` tells of it."""
    item = PlanItem(options=failed["options"], group=failed["group"], agent=failed["agent"] or alone)
    place = tuple(map(int, failed["key"].split(".")))
    start = EpisodeStart(item, place, failed["repeat"], failed["seed"], failed["run_seed"])
    described = {"id": failed["id"] or "unknown", "kwargs": failed["kwargs"]}
    if joint:
        return JointEpisode(**common_fields(described, start), failure=failed["error"])
    info = {"seed": start.seed, "error": failed["error"]}
    if item.group is not None:
        info["group"] = item.group
    return new_episode(described, start, TERMINAL_STATE, info)
