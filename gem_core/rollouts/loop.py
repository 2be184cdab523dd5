"""The loop: an agent plays an episode. Start to read GEM here.

``play`` is one episode: reset, ask, step, record, until it is over. ``play_slot`` plays the episodes of a plan in one
slot, one after another. ``run_slots`` does that in all slots side by side, and yields the episodes as they finish;
``rollout`` and ``arollout`` in ``drivers`` are what people call.
"""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine, Mapping
from contextlib import AbstractAsyncContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar, cast

from gem_core.background import run_sync, run_without_loop, side_by_side
from gem_core.errors import (
    ArgumentError,
    ContextOverflowError,
    EnvFaultError,
    EpisodeLimitError,
    GemError,
    RequestError,
)
from gem_core.failures import author_frames, failure_info
from gem_core.records.episode import Episode
from gem_core.records.joint import JointEpisode, Record
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.rollouts.agent import Agent, AgentTraits, is_asynchronous
from gem_core.rollouts.seat import RunningSeat, common_fields, new_episode
from gem_core.rollouts.seating import Seated, Seating
from gem_core.rollouts.shared_episode import SharedEpisode
from gem_core.types import TERMINAL_STATE, Info, Response
from gem_core.vector.failures import Failure
from gem_core.vector.joint import lost_step
from gem_core.vector.slot import ALL_IN_PLACE, Slot
from gem_core.vector.vector_env import VectorEnv

T = TypeVar("T")

Players = Seated | Mapping[str, Agent] | Seating
"""One agent; several by name, of which each item of the plan names one; or a rule for the seats."""

_CANCELLING_S = 5.0
"""Seconds that agents and environments may take to end when a run is left."""


@dataclass
class Run:
    """The state that all episodes of one rollout share.

    Args:
        vector: The vector environment whose slots play them.
        queue: The starts of episodes, in the order of the plan.
        players: The agents.
        max_requests: Largest number of agents' calls at once; None for no limit.
        here: Calls plain code in the thread of the caller.
        is_plain: Whether no agent is a coroutine function.
    """

    vector: VectorEnv
    queue: EpisodeQueue
    players: Players
    max_requests: int | None
    here: Callable[..., Awaitable[Any]]
    is_plain: bool = False

    def __post_init__(self) -> None:
        self.finished: asyncio.Queue[Record | None] = asyncio.Queue()
        """Finished episodes that the caller has not taken; None when all slots are done."""
        self._asynchronous: dict[int, bool] = {}
        limit = self.max_requests
        self.requests: AbstractAsyncContextManager[Any] = nullcontext() if limit is None else asyncio.Semaphore(limit)
        self.room = asyncio.Semaphore(self.vector.num_envs)
        """Room for finished episodes: a slot waits for it, until the caller takes one."""

    @cached_property
    def at_once(self) -> Run:
        """The same run for episodes that the caller's thread plays without waiting."""
        return replace(self, here=_at_once)

    def is_asynchronous(self, agent: Agent) -> bool:
        """Tell whether an agent is a coroutine function."""
        if id(agent) not in self._asynchronous:
            self._asynchronous[id(agent)] = not self.is_plain and is_asynchronous(agent)
        return self._asynchronous[id(agent)]

    async def in_slot(self, in_place: bool, work: Callable[..., Coroutine[Any, Any, T]], *args: Any) -> T:
        """Await work of a slot's environment, in the caller's thread if it must run there."""
        if in_place and self.vector.config.in_place is ALL_IN_PLACE:
            return cast("T", await self.here(lambda: run_without_loop(work(*args))))
        return await work(*args)

    async def prepare(self, slot: Slot, start: EpisodeStart) -> Failure | None:
        """Make the environment that an episode needs, in its slot; return the failure, if any."""
        return await self.in_slot(slot.prepares_in_place(start), slot.prepare, start)

    def player_of(self, start: EpisodeStart) -> Seated:
        """Return the only agent of an episode."""
        if isinstance(self.players, Seated):
            return self.players
        agents, name = dict(self.players.items() if isinstance(self.players, Mapping) else ()), start.item.agent
        if name is None or name not in agents:
            names = ", ".join(map(repr, agents))
            raise ArgumentError(f"an item of the plan has agent={name!r}, and the agents given are {names}")
        return Seated(name, agents[name])


async def play(run: Run, slot: Slot, start: EpisodeStart) -> Episode:
    """Play one episode to its end; return its record."""
    name, agent = run.player_of(start)
    # Reset.
    reset = await run.in_slot(slot.in_place, slot.reset, start)
    if isinstance(reset, Failure):
        return cast("Episode", failed_record(run, slot, start, slot.fault(reset)))
    observation, info = reset
    described = describe(slot)
    _check_seats(described["id"], info, alone=True)
    episode = new_episode(described, start, observation, info)
    episode.agent = name
    seat = RunningSeat(episode, AgentTraits.of(agent), slot.sample_random_action)
    while True:
        # Ask.
        try:
            response = await ask(run, agent, seat)
        except (EpisodeLimitError, RequestError, EnvFaultError) as failure:
            seat.cut_off(why_no_answer(slot, failure))
            return episode
        # Step.
        result = await run.in_slot(slot.in_place, slot.step, response)
        if isinstance(result, Failure):
            result = lost_step(slot.fault(result), joint=False)
        # Record.
        observation, reward, terminated, truncated, info = result
        seat.add(float(reward), bool(terminated), bool(truncated), observation, info)
        if terminated or truncated:
            return episode


async def play_joint(run: Run, slot: Slot, start: EpisodeStart) -> JointEpisode:
    """Play one episode of several agents to its end; return its record."""
    # Reset.
    reset = await run.in_slot(slot.in_place, slot.reset, start)
    if isinstance(reset, Failure):
        return cast("JointEpisode", failed_record(run, slot, start, slot.fault(reset)))
    observations, info = reset
    described = describe(slot)
    _check_seats(described["id"], info, alone=False)
    shared = SharedEpisode(slot, described, start, observations, info, cast("Seating", run.players))
    while True:
        # Ask all agents that act.
        try:
            responses = await ask_all(run, shared)
        except NoAnswerError as nobody:
            shared.cut_off(nobody.seat, why_no_answer(slot, nobody.failure))
            return shared.record
        # Step.
        result = await run.in_slot(slot.in_place, slot.step, shared.take(responses))
        if isinstance(result, Failure):
            result = lost_step(slot.fault(result), joint=True)
        # Record.
        observation, reward, terminated, truncated, info = result
        shared.add(reward, observation, info)
        if terminated or truncated:
            return shared.record


async def ask_all(run: Run, shared: SharedEpisode) -> dict[str, Response]:
    """Ask all agents that act now, asynchronous ones side by side.

    Raises:
        NoAnswerError: An agent has no answer; the others are cancelled.
    """

    async def answer(seat: str) -> Response:
        try:
            return await ask(run, shared.agent_at(seat), shared.running[seat])
        except (EpisodeLimitError, RequestError, EnvFaultError) as failure:
            raise NoAnswerError(seat, failure) from failure

    if run.is_plain or len(shared.acting) == 1:
        return {seat: await answer(seat) for seat in shared.acting}
    return await side_by_side({seat: answer(seat) for seat in shared.acting})


class NoAnswerError(Exception):
    """An agent among several has no answer.

    Args:
        seat: Its seat.
        failure: The reason.
    """

    def __init__(self, seat: str, failure: GemError) -> None:
        super().__init__(seat)
        self.seat, self.failure = seat, failure


async def ask(run: Run, agent: Agent, seat: RunningSeat) -> Response:
    """Return the agent's response to what its seat sees now.

    Raises:
        AgentError: The agent returned something else than text, or cancelled its own task.
        RequestError: The agent failed, and only this episode is lost.
        EpisodeLimitError: A limit of the agent is reached, such as the context of its model.
        EnvFaultError: The environment failed when the agent asked it for a random action.
    """
    if not run.is_plain:
        await asyncio.sleep(0)  # let other slots go on, even if the agent never waits
    async with run.requests:
        seen = seat.conversation.sent(), seat.context
        answer: Any = agent(*seen) if run.is_asynchronous(agent) else await run.here(agent, *seen)
        if run.here is _at_once and inspect.isawaitable(answer):
            answer = run_sync(answer)
        return await seat.take(answer)


def why_no_answer(slot: Slot, failure: GemError) -> Info:
    """Return the last info of an episode whose agent has no answer; a limit of the agent is no fault."""
    if isinstance(failure, EpisodeLimitError):
        overflow = {"context_overflow": True} if isinstance(failure, ContextOverflowError) else {}
        return {"cut_off": failure.limit, **overflow}
    of_env = isinstance(failure, EnvFaultError)
    if of_env and slot.config.on_error == "raise":
        raise failure
    message = str(failure).removeprefix(f"{slot.name()}: ")
    error = failure_info("exception" if of_env else "agent", message, author_frames(failure) if of_env else [])
    slot.cause = failure
    if isinstance(failure, RequestError) and failure.cause is not None:
        error["cause"] = failure.cause
    return {"error": error}


async def play_slot(run: Run, slot: Slot) -> None:
    """Play episodes of the plan in one slot, until there are no more."""
    while True:
        await run.room.acquire()
        start = run.queue.draw(slot.index)
        if start is None:
            break
        playing: Any = play_joint if isinstance(run.players, Seating) else play
        failure = await run.prepare(slot, start)
        if failure is not None:
            record: Record = failed_record(run, slot, start, slot.fault(failure))
        elif run.is_plain and slot.in_place:
            # Nothing waits: the caller's thread plays the whole episode.
            record = await run.here(_play_at_once, playing, run.at_once, slot, start)
        else:
            record = await playing(run, slot, start)
        run.finished.put_nowait(record)
        slot.note_end(record.error)
    await run.in_slot(slot.in_place, slot.release)


async def run_slots(run: Run) -> AsyncGenerator[Record]:
    """Play the episodes of a plan in all slots, and yield each as it finishes.

    An error that stops the run is raised after the episodes that finished before it. When the caller leaves, working
    agents and environments are cancelled.
    """
    tasks = [asyncio.create_task(play_slot(run, slot)) for slot in run.vector.slots]
    ended = asyncio.gather(*tasks)

    def tell(_: object) -> None:
        run.finished.put_nowait(None)
        if not ended.cancelled():
            ended.exception()  # so that asyncio does not log it where the caller has left

    ended.add_done_callback(tell)
    try:
        while (record := await run.finished.get()) is not None:
            yield record
            run.room.release()
        await ended
    finally:
        for task in tasks:
            task.cancel()
        # A coroutine that swallows its cancellation must not block the end of the run.
        await asyncio.wait(tasks, timeout=_CANCELLING_S)


def describe(slot: Slot) -> dict[str, Any]:
    """Return ``id``, ``kwargs`` and ``wrappers`` of the environment in a slot."""
    described = slot.runner.describe()
    return {**described, "id": described["id"] or slot.env_id or "unknown"}


def failed_record(run: Run, slot: Slot, start: EpisodeStart, error: dict[str, Any]) -> Record:
    """Return the record of an episode that did not begin."""
    env_id, kwargs = slot.target(start)
    described = {"id": env_id or "unknown", "kwargs": dict(kwargs)}
    if isinstance(run.players, Seating):
        return JointEpisode(**common_fields(described, start), failure=error)
    info = {"seed": start.seed, "error": error}
    if start.item.group is not None:
        info["group"] = start.item.group
    episode = new_episode(described, start, TERMINAL_STATE, info)
    episode.agent = run.player_of(start).name
    return episode


def _play_at_once(play: Callable[..., Coroutine[Any, Any, T]], *args: Any) -> T:
    return run_without_loop(play(*args))


async def _at_once(function: Callable[..., T], *args: Any) -> T:
    return function(*args)


def _check_seats(env_id: str, info: Info, *, alone: bool) -> None:
    """Raise if one agent is given for several seats, or several agents for one."""
    if alone and "possible_agents" in info:
        seats = ", ".join(map(repr, info["possible_agents"]))
        raise ArgumentError(
            f"{env_id} has several seats, {seats}: give agents={{seat: agent}}, a list of agents that "
            f"change seats, or agents=AGENT for self-play; for 'gem run', register it with seats=({seats})"
        )
    if not alone and "possible_agents" not in info:
        raise ArgumentError(f"{env_id} is for one agent: give agent, not agents")
