"""``EpisodeLoop``: sends observations to an agent and its actions to environments. ``drivers`` does the waiting."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from gem_core import __version__
from gem_core.errors import ContextOverflowError, EnvFaultError, GemError
from gem_core.records.conversation import CONCAT_WITH_ACTION, Conversation
from gem_core.records.episode import Episode, Transition
from gem_core.records.plans import EpisodeQueue, EpisodeStart, PlanItem
from gem_core.registry.lookup import registry
from gem_core.rollouts.agent import Context, Reading
from gem_core.rollouts.requests import AgentRequests
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
        self._running: dict[int, _RunningEpisode] = {}
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
            self._running[slot] = _RunningEpisode(self._vector, slot, start, observation, info, self._reading)
            self._unasked.append(slot)

    def _give_up(self, slot: int, failure: GemError) -> None:
        """End an episode because its agent has no answer; a history that is too long for the model is no fault."""
        of_env = isinstance(failure, EnvFaultError)
        if of_env and self._vector.on_error == "raise":
            raise failure
        episode = self._running.pop(slot).episode
        error: dict[str, Any] | None = None
        reported: Info = {"context_overflow": True}
        if not isinstance(failure, ContextOverflowError):
            message = str(failure).removeprefix(f"{episode.id}: ")
            error = {"kind": "exception" if of_env else "agent", "message": message}
            reported = {"error": error}
        _cut_off(episode, reported)
        self._finished.append(episode)
        self._vector.give_up(slot, error)


class _RunningEpisode:
    """The present episode of a slot, and the context of its agent."""

    def __init__(
        self, vector: VectorEnv, slot: int, start: EpisodeStart, observation: Observation, info: Info, reading: Reading
    ) -> None:
        self.episode = new_episode(vector.describe(slot), start, observation, info)
        self.episode.reads = _what_to_read(reading, info)
        self.episode.system = reading.system
        self.episode.native_tools = reading.native_tools and bool(info.get("tools"))
        self.conversation = Conversation(self.episode)
        self.response = Response()
        """What was sent to the environment last."""
        self.context = Context(
            episode=f"{start.key}.{start.repeat}",
            env_id=self.episode.id,
            group=start.item.group,
            turn=0,
            info=info,
            tools=info.get("tools", []),
            transitions=self.episode.transitions,
            system=self.conversation.system,
            draw_action=lambda: vector.sample_random_action(slot),
            read_messages=self.conversation.messages,
        )

    def add(self, reward: float, terminated: bool, truncated: bool, observation: Observation, info: Info) -> None:
        """Add the turn in which ``response`` was sent."""
        episode = self.episode
        answered = episode.final_observation
        episode.transitions.append(Transition(answered, self.response, reward, terminated, truncated, info))
        episode.final_observation = observation
        self.context.turn += 1
        self.context.info = info


def _cut_off(episode: Episode, reported: Info) -> None:
    """End an episode between two turns, with the reason in its last info."""
    if episode.transitions:
        last = episode.transitions[-1]
        last.truncated, last.info = True, {**last.info, **reported}
    else:
        episode.info = {**episode.info, **reported}


def _what_to_read(reading: Reading, info: Info) -> str:
    """Return what an agent is sent in an episode that begins: what it reads, unless a view was named."""
    if info.get("view") is not None:
        return "observation"
    if reading.reads is not None:
        return reading.reads
    return CONCAT_WITH_ACTION if info.get("tools") else "observation"


def _failed_reset(failed: Mapping[str, Any]) -> Episode:
    """Return the episode of a reset that failed, from what ``info["failed_resets"]`` tells of it."""
    item = PlanItem(options=failed["options"], group=failed["group"])
    place = tuple(map(int, failed["key"].split(".")))
    start = EpisodeStart(item, place, failed["repeat"], failed["seed"], failed["run_seed"])
    info = {"seed": start.seed, "error": failed["error"]}
    if item.group is not None:
        info["group"] = item.group
    return new_episode({"id": failed["id"] or "unknown", "kwargs": failed["kwargs"]}, start, TERMINAL_STATE, info)


def new_episode(described: Mapping[str, Any], start: EpisodeStart, observation: Observation, info: Info) -> Episode:
    """Return the record of an episode that begins, of an agent that reads observations.

    Args:
        described: ``id``, ``kwargs`` and ``wrappers`` of its environment.
        start: What it starts from.
        observation: What ``reset`` returned.
        info: What ``reset`` returned with it.
    """
    return Episode(
        id=described["id"],
        seed=start.seed,
        observation=observation,
        info=info,
        final_observation=observation,
        kwargs=described["kwargs"],
        wrappers=described.get("wrappers", []),
        tools=[tool["function"]["name"] for tool in info.get("tools", [])],
        options=start.item.options,
        group=start.item.group,
        key=start.key,
        repeat=start.repeat,
        reads="observation",
        run_seed=start.run_seed,
        versions=_versions(described["id"]),
    )


def _versions(env_id: str) -> dict[str, str]:
    """Return the version of each distribution that takes part."""
    provider = registry().provider(env_id)
    versions = {"gem-core": __version__}
    if provider is not None:
        versions[provider.distribution] = provider.version
    return versions
