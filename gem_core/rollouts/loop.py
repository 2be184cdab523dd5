"""The loop that joins an agent to environments; ``rollouts`` drives it, in plain code or in a coroutine."""

from __future__ import annotations

from collections.abc import Mapping
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
from gem_core.vector.actions import Received
from gem_core.vector.vector_env import VectorEnv


class EpisodeLoop:
    """Episodes that are under way in the slots of a vector environment.

    Each slot is stepped as soon as its agent has answered, and its agent is asked as soon as the slot is ready: neither
    a slow answer nor a slow environment holds up anything but its own slot.

    Args:
        vector: Where they run.
        asking: Puts the questions to the agent.
        reading: What the agent wants to be sent.
    """

    def __init__(self, vector: VectorEnv, asking: AgentRequests, reading: Reading) -> None:
        self._vector = vector
        self._asking = asking
        self._reading = reading
        self._running: dict[int, _Running] = {}
        self._to_ask: list[int] = []
        self._stopped_by: BaseException | None = None

    def begin(self, source: EpisodeQueue) -> None:
        """Begin an episode in every slot."""
        self._vector.send_reset(source)

    @property
    def over(self) -> bool:
        """Whether nothing is under way any more."""
        return not self._running and not self._vector.under_way and self._stopped_by is None

    def has_news(self) -> bool:
        """Tell whether there is an answer of the agent to step, or nothing to wait for."""
        return bool(self._to_ask) or self._asking.is_ready() or self._stopped_by is not None or self.over

    def advance(self) -> list[Episode]:
        """Take the answers and the results that are there, without waiting; return the episodes that are over.

        What stops the run is raised behind them, by the next call, so that none of them is lost.
        """
        if self._stopped_by is not None:
            raise self._stopped_by
        finished: list[Episode] = []
        try:
            self._advance(finished)
        except (Exception, KeyboardInterrupt) as error:
            if not finished:
                raise
            self._stopped_by = error
        return finished

    def _advance(self, finished: list[Episode]) -> None:
        self._ask_all()
        answers = self._asking.answers()
        responses = {slot: answer for slot, answer in answers.items() if isinstance(answer, Response)}
        for slot, answer in responses.items():
            self._running[slot].answer = answer
        if responses:
            self._vector.send(responses)
        for slot, failure in answers.items():
            if not isinstance(failure, Response):
                self._give_up(slot, failure, finished)
        if self._vector.under_way:
            received = self._vector.recv(min_envs=0)
            for place in range(len(received.slots)):
                self._take(received, place, finished)
        # A plain agent answers here and now: it is asked once whoever waits for these episodes has had them.
        if self._asking.asynchronous:
            self._ask_all()

    def _take(self, received: Received, place: int, finished: list[Episode]) -> None:
        slot = received.slots[place]
        observation, info = received.observations[place], received.infos[place]
        current = self._running.get(slot)
        if current is not None:
            terminated, truncated = bool(received.terminated[place]), bool(received.truncated[place])
            reward = float(received.rewards[place])
            over = terminated or truncated
            if over and self._vector.autoreset == "same_step":
                current.add(reward, terminated, truncated, info.pop("final_obs"), info.pop("final_info"))
            else:
                current.add(reward, terminated, truncated, observation, info)
            if over:
                finished.append(self._running.pop(slot).episode)
                current = None
                if self._vector.autoreset != "same_step":
                    self._vector.begin_next(slot)
                    return
        if current is None:
            finished.extend(_failed(failed) for failed in info.pop("failed_resets", ()))
            draw = self._vector.start_of(slot)
            if draw is None:
                return
            current = self._running[slot] = _Running(self._vector, slot, draw, observation, info, self._reading)
        self._to_ask.append(slot)

    def _ask_all(self) -> None:
        to_ask, self._to_ask = self._to_ask, []
        for slot in to_ask:
            current = self._running[slot]
            self._asking.ask(slot, current.conversation.sent(), current.context)

    def _give_up(self, slot: int, failure: GemError, finished: list[Episode]) -> None:
        """End an episode whose agent could not be asked, or whose history has grown too long."""
        of_env = isinstance(failure, EnvFaultError)
        if of_env and self._vector.on_error == "raise":
            raise failure
        current = self._running.pop(slot)
        if isinstance(failure, ContextOverflowError):
            finished.append(current.give_up({"context_overflow": True}))
            self._vector.give_up(slot, None)
            return
        message = str(failure).removeprefix(f"{current.episode.id}: ")
        error = {"kind": "exception" if of_env else "agent", "message": message}
        finished.append(current.give_up({"error": error}))
        self._vector.give_up(slot, error)


class _Running:
    """An episode that is under way in a slot."""

    def __init__(
        self, vector: VectorEnv, slot: int, draw: EpisodeStart, observation: Observation, info: Info, reading: Reading
    ) -> None:
        self.episode = new_episode(vector.describe(slot), draw, observation, info)
        self.episode.reads = _sent_as(reading, info)
        self.episode.system = reading.system
        self.episode.native_tools = reading.native_tools and bool(info.get("tools"))
        self.conversation = Conversation(self.episode)
        self.observation = observation
        self.answer = Response()
        self.context = Context(
            episode=f"{draw.key}.{draw.repeat}",
            env_id=self.episode.id,
            group=draw.item.group,
            turn=0,
            info=info,
            tools=info.get("tools", []),
            transitions=self.episode.transitions,
            system=self.conversation.system,
            _messages=self.conversation.messages,
            _sample=lambda: vector.sample_random_action(slot),
        )

    def add(self, reward: float, terminated: bool, truncated: bool, observation: Observation, info: Info) -> None:
        """Add the turn in which ``answer`` was stepped."""
        turn = Transition(self.observation, self.answer, reward, terminated, truncated, info)
        self.episode.transitions.append(turn)
        self.observation = self.episode.final_observation = observation
        self.context.turn += 1
        self.context.info = info

    def give_up(self, reported: Info) -> Episode:
        """End the episode between two turns, with the reason in its last info; return it."""
        if self.episode.transitions:
            last = self.episode.transitions[-1]
            last.truncated, last.info = True, {**last.info, **reported}
        else:
            self.episode.info = {**self.episode.info, **reported}
        return self.episode


def _sent_as(reading: Reading, info: Info) -> str:
    """Return what an agent is sent in an episode that begins: what it reads, unless a view was named."""
    if info.get("view") is not None:
        return "observation"
    if reading.reads is not None:
        return reading.reads
    return CONCAT_WITH_ACTION if info.get("tools") else "observation"


def _failed(failed: Mapping[str, Any]) -> Episode:
    """Return the episode of a reset that failed; see ``Slot.begin``."""
    item = PlanItem(options=failed["options"], group=failed["group"])
    place = tuple(map(int, failed["key"].split(".")))
    draw = EpisodeStart(item, place, failed["repeat"], failed["seed"], failed["run_seed"])
    reported = {"seed": draw.seed, "error": failed["error"]}
    if item.group is not None:
        reported["group"] = item.group
    described = {"id": failed["id"] or "unknown", "kwargs": failed["kwargs"]}
    return new_episode(described, draw, TERMINAL_STATE, reported)


def new_episode(described: dict[str, Any], draw: EpisodeStart, observation: Observation, info: Info) -> Episode:
    """Return the record of an episode that begins, of an agent that reads observations.

    Args:
        described: ``id``, ``kwargs`` and ``wrappers`` of its environment.
        draw: What it starts from.
        observation: What ``reset`` returned, with ``info``.
        info: See above.
    """
    return Episode(
        id=described["id"],
        seed=draw.seed,
        observation=observation,
        info=info,
        final_observation=observation,
        kwargs=described["kwargs"],
        wrappers=described.get("wrappers", []),
        tools=[tool["function"]["name"] for tool in info.get("tools", [])],
        options=draw.item.options,
        group=draw.item.group,
        key=draw.key,
        repeat=draw.repeat,
        reads="observation",
        run_seed=draw.run_seed,
        versions=_versions(described["id"]),
    )


def _versions(env_id: str) -> dict[str, str]:
    provider = registry().provider(env_id)
    versions = {"gem-core": __version__}
    if provider is not None:
        versions[provider.distribution] = provider.version
    return versions
