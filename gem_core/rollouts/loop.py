"""The loop: agents play an episode. Start to read GEM here.

``play`` is one episode: reset, ask, step, record, until it is over. Where nothing waits, ``play_here`` plays the plan
in the caller's thread, slot after slot. Else a ``Run`` has a ``play_slot`` for each slot, side by side, and returns the
episodes as they finish. ``rollout`` and ``arollout`` in ``drivers`` are what people call.
"""

from __future__ import annotations

import asyncio
import inspect
import itertools
from collections.abc import Awaitable, Callable, Coroutine, Iterator, Mapping
from contextlib import nullcontext
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
from gem_core.failures import Failure, author_frames, failure_info
from gem_core.records.joint import JointEpisode, Record
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.rollouts.seat import RunningSeat, SharedEpisode, common_fields, new_episode
from gem_core.rollouts.seating import ALONE, Seating
from gem_core.types import TERMINAL_STATE, Info, Observation, Response
from gem_core.vector.joint import lost_step
from gem_core.vector.slot import ALL_IN_PLACE, Slot
from gem_core.vector.vector_env import VectorEnv

T = TypeVar("T")

_CANCELLING_S = 5.0
"""Seconds that agents and environments may take to end when a run is left."""

_working: set[asyncio.Task[None]] = set()
"""The tasks of all slots; an event loop keeps only weak references to its tasks."""


async def play(run: Run, slot: Slot, start: EpisodeStart) -> Record:
    """Play one episode to its end; return its record."""
    # Reset.
    reset = await run.in_slot(slot.in_place, slot.reset, start)
    if isinstance(reset, Failure):
        return failed_record(run, slot, start, slot.fault(reset))
    episode = begin_episode(run, slot, start, *reset)
    while not episode.is_over:
        # Ask all agents that act.
        try:
            responses = await ask_all(run, episode.acting)
        except NoAnswerError as nobody:
            episode.cut_off(why_no_answer(slot, nobody.failure), at=nobody.seat)
            break
        # Step.
        result = await run.in_slot(slot.in_place, slot.step, episode.take(responses))
        if isinstance(result, Failure):
            result = lost_step(slot.fault(result), joint=isinstance(episode, SharedEpisode))
        # Record.
        episode.add(*result)
    return episode.record


async def ask_all(run: Run, acting: Mapping[str, RunningSeat]) -> dict[str, Response]:
    """Ask all agents that act now, asynchronous ones side by side.

    Raises:
        NoAnswerError: An agent has no answer; the others are cancelled.
    """
    if run.is_plain or len(acting) == 1:
        return {name: await ask(run, seat) for name, seat in acting.items()}
    return await side_by_side({name: ask(run, seat) for name, seat in acting.items()})


async def ask(run: Run, seat: RunningSeat) -> Response:
    """Return the agent's response to what its seat sees now.

    Raises:
        AgentError: The agent returned something else than text, or cancelled its own task.
        NoAnswerError: The agent failed and only this episode is lost; or a limit is reached, such as the context of its
            model; or the environment failed when the agent asked it for a random action.
    """
    if not run.is_plain:
        await asyncio.sleep(0)  # let other slots go on, even if the agent never waits
    try:
        async with run.requests:
            seen = seat.conversation.sent(), seat.context
            is_called_here = run.is_here or seat.is_asynchronous
            answer: Any = seat.agent(*seen) if is_called_here else await run.here(seat.agent, *seen)
            if run.is_here and inspect.isawaitable(answer):
                answer = run_sync(answer)
            return await seat.read_answer(answer)
    except (EpisodeLimitError, RequestError, EnvFaultError) as failure:
        raise NoAnswerError(seat.record.seat, failure) from failure


class NoAnswerError(Exception):
    """An agent has no answer.

    Args:
        seat: Its seat among several.
        failure: The reason.
    """

    def __init__(self, seat: str | None, failure: GemError) -> None:
        super().__init__(seat)
        self.seat, self.failure = seat, failure


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


def play_here(run: Run) -> Iterator[Record]:
    """Play with plain agents in the caller's thread, one episode after another, until an environment runs elsewhere.

    That environment's episode is left in ``run.drawn``: ``next_record`` goes on with it, in all slots side by side.
    """
    run.is_here = True
    run_without_loop(run.vector.begin_rollout())
    for slot in itertools.cycle(run.vector.slots):
        start = run.queue.draw(slot.index)
        if start is None:
            break
        failure = None
        if not slot.fits(start) and slot.makes_in_place(start):
            failure = run_without_loop(slot.make(start))
        if failure is not None:
            record = failed_record(run, slot, start, slot.fault(failure))
        elif slot.in_place and slot.fits(start):
            record = run_without_loop(play(run, slot, start))
        else:
            run.drawn[slot.index], run.is_here = start, False
            return
        yield record
        slot.note_end(record.error)
    for slot in run.vector.slots:
        run_without_loop(slot.release())


async def play_slot(run: Run, slot: Slot) -> None:
    """Play episodes of the plan in one slot, until there are no more."""
    while True:
        await run.room.acquire()
        start = run.drawn.pop(slot.index, None) or run.queue.draw(slot.index)
        if start is None:
            break
        failure = None
        if not slot.fits(start):
            failure = await run.in_slot(slot.makes_in_place(start), slot.make, start)
        if failure is not None:
            record = failed_record(run, slot, start, slot.fault(failure))
        else:
            record = await play(run, slot, start)
        run.finished.put_nowait(record)
        slot.note_end(record.error)
    await run.in_slot(slot.in_place, slot.release)


class Run:
    """The episodes of a plan, played in all slots of a vector environment.

    Args:
        vector: The vector environment.
        queue: The starts of episodes, in the order of the plan.
        seating: Says which agents play an episode.
        max_requests: Largest number of agents' calls at once; None for no limit.
        here: Calls plain code in the thread of the caller.
        is_plain: Whether the caller is plain code, and no agent is a coroutine function.
    """

    def __init__(
        self,
        vector: VectorEnv,
        queue: EpisodeQueue,
        seating: Seating,
        max_requests: int | None,
        here: Callable[..., Awaitable[Any]],
        is_plain: bool,
    ) -> None:
        self.vector, self.queue, self.seating, self.here, self.is_plain = vector, queue, seating, here, is_plain
        self.is_here = False
        """Whether ``play_here`` plays in the caller's thread."""
        self.drawn: dict[int, EpisodeStart] = {}
        """The episode that is next in a slot, if it was drawn already."""
        self.requests: Any = nullcontext() if max_requests is None else asyncio.Semaphore(max_requests)
        self.room = asyncio.Semaphore(vector.num_envs)
        """Room for finished episodes: a slot waits for it, until the caller takes one."""
        self.finished: asyncio.Queue[Record | None] = asyncio.Queue()
        """Finished episodes that the caller has not taken; None when all slots are done."""
        self.tasks: list[asyncio.Task[None]] = []
        """The work of all slots, once it has begun."""

    async def _begin(self) -> None:
        """Begin to play in all slots."""
        await self.vector.begin_rollout()
        self.tasks = [asyncio.create_task(play_slot(self, slot)) for slot in self.vector.slots]
        _working.update(self.tasks)
        for task in self.tasks:
            task.add_done_callback(_working.discard)
        self._ended = asyncio.gather(*self.tasks)
        self._ended.add_done_callback(self._note_end)

    async def next_record(self) -> Record | None:
        """Return the next episode that finishes; None after the last.

        An error that stops the run is raised after the episodes that finished before it.
        """
        if self.tasks:
            self.room.release()
        else:
            await self._begin()
        record = await self.finished.get()
        if record is None:
            await self._ended
        return record

    async def stop(self) -> None:
        """Cancel the agents and environments that are at work."""
        for task in self.tasks:
            task.cancel()
        if self.tasks:  # a coroutine that swallows its cancellation must not block the end of the run
            await asyncio.wait(self.tasks, timeout=_CANCELLING_S)

    def _note_end(self, ended: asyncio.Future[Any]) -> None:
        self.finished.put_nowait(None)
        if not ended.cancelled():
            ended.exception()  # so that asyncio does not log it if the caller has left

    async def in_slot(self, in_place: bool, work: Callable[..., Coroutine[Any, Any, T]], *args: Any) -> T:
        """Await work of a slot's environment, in the caller's thread if it must run there."""
        if in_place and not self.is_here and self.vector.config.in_place is ALL_IN_PLACE:
            return cast("T", await self.here(lambda: run_without_loop(work(*args))))
        return await work(*args)


def begin_episode(
    run: Run, slot: Slot, start: EpisodeStart, observation: Observation, info: Info
) -> RunningSeat | SharedEpisode:
    """Return the episode that a reset began, with an agent at each seat.

    Raises:
        ArgumentError: One agent is given for several seats, or several agents for one.
    """
    described = slot.runner.describe()
    described = {**described, "id": described["id"] or slot.env_id or "unknown"}
    seats, is_alone = info.get("possible_agents"), run.seating.is_alone
    if seats is None and not is_alone:
        raise ArgumentError(f"{described['id']} is for one agent: give agent, not agents")
    if seats is not None and is_alone:
        names = ", ".join(map(repr, seats))
        raise ArgumentError(
            f"{described['id']} has several seats, {names}: give agents={{seat: agent}}, a list of agents that "
            f"change seats, or agents=AGENT for self-play; for 'gem run', register it with seats=({names})"
        )
    seated = run.seating.seat(seats or [ALONE], start)
    if seats is not None:
        return SharedEpisode(described, start, observation, info, seated, slot.sample_random_action)
    return RunningSeat(new_episode(described, start, observation, info), seated[ALONE], slot.sample_random_action)


def failed_record(run: Run, slot: Slot, start: EpisodeStart, error: dict[str, Any]) -> Record:
    """Return the record of an episode that did not begin."""
    env_id, kwargs = slot.target(start)
    described = {"id": env_id or "unknown", "kwargs": dict(kwargs)}
    if not run.seating.is_alone:
        return JointEpisode(**common_fields(described, start), failure=error)
    info = {"seed": start.seed, "error": error}
    if start.item.group is not None:
        info["group"] = start.item.group
    episode = new_episode(described, start, TERMINAL_STATE, info)
    episode.agent = run.seating.seat([ALONE], start)[ALONE].name
    return episode
