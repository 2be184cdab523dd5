"""An episode under way: ``RunningSeat`` of one agent, ``SharedEpisode`` of several, and the records made of them."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from gem_core import __version__
from gem_core.errors import AgentError
from gem_core.records.conversation import CONCAT_WITH_ACTION, Conversation
from gem_core.records.episode import Episode, Transition
from gem_core.records.joint import JointEpisode
from gem_core.records.plans import EpisodeStart
from gem_core.registry.lookup import registry
from gem_core.rollouts.agent import AgentTraits, Context, is_asynchronous
from gem_core.rollouts.seating import ALONE, Seated
from gem_core.types import TERMINAL_STATE, Info, Observation, Response


class RunningSeat:
    """The present episode of one agent, alone in its environment or at a seat among others.

    Args:
        record: The record, with its first observation; turns are added to it.
        seated: The agent, with its name.
        draw_action: Returns a valid random action.
    """

    def __init__(self, record: Episode, seated: Seated, draw_action: Callable[[], str]) -> None:
        info, self.record, self.agent = record.info, record, seated.agent
        self.is_asynchronous = is_asynchronous(seated.agent)
        self.is_over = False
        traits = AgentTraits.of(seated.agent)
        record.agent, record.system = seated.name, traits.system
        record.reads = _what_to_read(traits, info)
        record.native_tools = traits.native_tools and bool(info.get("tools"))
        self.conversation = Conversation(record)
        self.response = Response()
        """The last response that the environment was sent."""
        self.context = Context(
            episode=f"{record.key}.{record.repeat}",
            env_id=record.id,
            group=record.group,
            turn=0,
            info=info,
            tools=info.get("tools", []),
            transitions=record.transitions,
            system=self.conversation.system,
            draw_action=draw_action,
            read_messages=self.conversation.messages,
            seat=record.seat,
            read_observation=partial(getattr, record, "final_observation"),  # a copy of the seat reads its own
            view=info.get("view"),
        )

    @property
    def acting(self) -> dict[str, RunningSeat]:
        """Who acts now, for an agent alone."""
        return {ALONE: self}

    async def read_answer(self, answer: Any) -> Response:
        """Return what the agent answered, a coroutine's result included, as the response of this turn.

        Raises:
            AgentError: It is no text, or the coroutine was cancelled by the agent itself.
        """
        if inspect.isawaitable(answer):
            try:
                answer = await answer
            except asyncio.CancelledError:
                task = asyncio.current_task()
                if task is not None and task.cancelling():
                    raise
                raise AgentError("the agent's coroutine was cancelled; an agent must not cancel its own task") from None
        if not isinstance(answer, str):
            raise AgentError(f"an agent returns a str or a Response, and this one returned {type(answer).__name__}")
        self.response = Response.of(answer)
        return self.response

    def take(self, responses: Mapping[str, Response]) -> Response:
        """Return the action of an agent alone."""
        return responses[ALONE]

    def add(self, observation: Observation, reward: float, terminated: bool, truncated: bool, info: Info) -> None:
        """Add the turn in which ``response`` was sent."""
        record, terminated, truncated = self.record, bool(terminated), bool(truncated)
        turn = Transition(record.final_observation, self.response, float(reward), terminated, truncated, info)
        record.transitions.append(turn)
        record.final_observation = observation
        self.context.turn += 1
        self.context.info = info
        self.is_over = terminated or truncated

    def cut_off(self, reported: Info, at: str | None = None) -> None:
        """End the episode between two turns, with the reason in its last info."""
        self.is_over = True
        record = self.record
        if record.transitions:
            last = record.transitions[-1]
            last.truncated, last.info = True, {**last.info, **reported}
        else:
            record.info = {**record.info, **reported}


class SharedEpisode:
    """The present episode of several agents, each at its seat.

    Args:
        described: ``id``, ``kwargs`` and ``wrappers`` of its environment.
        start: The episode's start.
        observations: The first observations, by seat.
        info: The info of that reset.
        seated: The agent at each seat.
        draw_action: Returns a valid random action of a seat.
    """

    def __init__(
        self,
        described: Mapping[str, Any],
        start: EpisodeStart,
        observations: Any,
        info: Info,
        seated: Mapping[str, Seated],
        draw_action: Callable[[str], str],
    ) -> None:
        self.record = JointEpisode(
            **common_fields(described, start), agents={seat: one.name for seat, one in seated.items()}
        )
        self.is_over = False
        self._seats: dict[str, RunningSeat] = {}
        """The episode of each seat that was shown something."""
        self._described, self._start, self._seated, self._draw_action = described, start, seated, draw_action
        for seat, observation in observations.items():
            self._begin(seat, observation, 0.0, info["agents"][seat])
        self.acting = dict(self._seats)
        """Who acts now."""

    def take(self, responses: Mapping[str, Response]) -> Any:
        """Note who acts; return the action."""
        self.record.order.append(list(responses))
        return responses

    def add(self, observation: Any, reward: Any, terminated: bool, truncated: bool, info: Info) -> None:
        """Add a turn for everybody who acts again or has ended; of a step that failed, for all whose turn was open."""
        self.is_over = terminated or truncated
        if "error" in info and not info["agents"]:
            self.record.failure = info["error"]
            for running in self._seats.values():
                if not running.is_over:
                    running.add(TERMINAL_STATE, 0.0, False, True, {"error": info["error"]})
            return
        for seat, own in info["agents"].items():
            seen = observation[seat] if seat in observation else own["final_obs"]
            own = {name: value for name, value in own.items() if name != "final_obs"}
            ended, cut = info["terminations"][seat], info["truncations"][seat]
            if seat in self._seats:
                self._seats[seat].add(seen, reward[seat], ended, cut, own)
            else:
                self._begin(seat, seen, reward[seat], own)
                self._seats[seat].record.ended_first = ended
                self._seats[seat].is_over = ended or cut
        self.acting = {seat: self._seats[seat] for seat in observation}
        if "error" in info:  # at some seats; the others were cut off by it
            cut_off = [self._seats[seat] for seat in info["agents"] if info["truncations"][seat]]
            failed = next((repr(each.record.seat) for each in cut_off if each.record.error is not None), "another seat")
            for each in cut_off:
                if each.record.error is None:
                    each.cut_off({"error": {"kind": "opponent", "message": f"an error at {failed}"}})

    def cut_off(self, reported: Info, at: str | None = None) -> None:
        """End the episode for everybody, since one seat has no answer; the others could not finish it."""
        no_answer = {"kind": "opponent", "message": f"the agent at {at!r} has no answer"}
        for seat, running in self._seats.items():
            if seat == at:
                running.cut_off(reported)
            elif not running.is_over:
                running.cut_off({"error": no_answer})

    def _begin(self, seat: str, observation: Observation, reward: float, info: Info) -> None:
        """Begin the episode of a seat with the first observation that it is shown."""
        described = {**self._described, "wrappers": self.record.wrappers_of(seat)}
        record = new_episode(described, self._start, observation, info)
        record.seat, record.first_reward = seat, reward
        self._seats[seat] = RunningSeat(record, self._seated[seat], partial(self._draw_action, seat))
        self.record.seats = {each: self._seats[each].record for each in self._seated if each in self._seats}


def _what_to_read(traits: AgentTraits, info: Info) -> str:
    """Return the ``reads`` of an episode: the agent's own, unless a view was named."""
    if info.get("view") is not None:
        return "observation"
    if traits.reads is not None:
        return traits.reads
    return CONCAT_WITH_ACTION if info.get("tools") else "observation"


def new_episode(described: Mapping[str, Any], start: EpisodeStart, observation: Observation, info: Info) -> Episode:
    """Return the record of an episode that begins, for an agent that reads observations.

    Args:
        described: ``id``, ``kwargs``, ``wrappers`` and, if it has one, ``return_range`` of its environment.
        start: The episode's start.
        observation: The observation that ``reset`` returned.
        info: The info that ``reset`` returned.
    """
    tools = [tool["function"]["name"] for tool in info.get("tools", [])]
    return Episode(
        **common_fields(described, start),
        observation=observation,
        info=info,
        final_observation=observation,
        tools=tools,
        reads="observation",
        agent=start.item.agent,
        return_range=described.get("return_range"),
    )


def common_fields(described: Mapping[str, Any], start: EpisodeStart) -> dict[str, Any]:
    """Return the fields that the records of one agent and of several have in common."""
    return {
        "id": described["id"],
        "seed": start.seed,
        "kwargs": described["kwargs"],
        "wrappers": described.get("wrappers", []),
        "options": start.item.options,
        "group": start.item.group,
        "key": start.key,
        "repeat": start.repeat,
        "run_seed": start.run_seed,
        "versions": _versions_of(described["id"]),
    }


def _versions_of(env_id: str) -> dict[str, str]:
    """Return the version of each distribution that takes part in an episode of an environment."""
    provider = registry().provider(env_id)
    versions = {"gem-core": __version__}
    if provider is not None:
        versions[provider.distribution] = provider.version
    return versions
