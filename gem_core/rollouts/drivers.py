"""``rollout`` and ``arollout``: an agent acts in environments, and each episode comes out as it finishes."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium

from gem_core.api import make_vec
from gem_core.background import in_thread
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError
from gem_core.records.episode import Episode
from gem_core.records.plans import EpisodeQueue, PlanItem, count_plan, cover_plan, interleaved
from gem_core.rollouts.agent import Agent, Reading, as_agent, prepare_agent
from gem_core.rollouts.loop import EpisodeLoop
from gem_core.rollouts.requests import AgentRequests, is_asynchronous
from gem_core.rollouts.resume import Done, done_in
from gem_core.vector.backends import around
from gem_core.vector.env import VectorEnv
from gem_core.vector.setup import IdOrIds, new_source

DEFAULT_EPISODES = 10
DEFAULT_REQUESTS = 64

Environments = VectorEnv | AnyEnv | IdOrIds
"""A vector environment, an environment, an id or several."""

Resume = str | Path | Iterable[Episode] | Done | None
"""A file of episodes, or the episodes; or what was found there, as ``done_in`` returns it."""

OnProgress = Callable[[int, int | None], None]
"""Called with the number of episodes that are over, and of all, where that is known."""


def rollout(
    env: Environments,
    agent: Any,
    *,
    plan: Iterable[PlanItem] | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    num_envs: int | None = None,
    max_requests: int | None = None,
    resume: Resume = None,
    progress: bool | OnProgress = False,
) -> Iterator[Episode]:
    """Let an agent act, and yield each episode as it finishes.

    The episodes are fixed before they start: the same plan and seed give the same ones, whatever the number of slots,
    the backend, and the order in which they finish.
    A plain agent is asked for one slot after another; an asynchronous one for each slot as soon as it is ready, so that
    neither a slow answer nor a slow environment holds up anything but its own slot. Nothing runs ahead of whoever takes
    the episodes: while one is looked at, no slot takes another step.

    Args:
        env: A vector environment, an environment, an id or several. What was made here is closed at the end; what was
            given is left open.
        agent: Called as ``agent(observation, context)``, or with the observation alone; plain or a coroutine function.
            It returns a ``str`` or a ``Response``.
        plan: What episodes start from; see ``gem_core.records.plans``.
        episodes: Instead of a plan, the number of episodes for each environment; a data set gives its first rows. With
            neither, the vector environment's own plan is taken from the beginning; where it has none, each row of a
            data set once, and ten episodes of an environment without rows.
        seed: Seed of the run; None takes the vector environment's, or draws one.
        num_envs: Where ids are given, how many environments run at once; None for as many as the agent may be asked at
            once: ``max_requests``, or else its ``max_concurrency``, or else 64 for an asynchronous one, and one for
            each id where the agent is plain.
        max_requests: Questions to an asynchronous agent that are open at once; None for as many as there are slots.
        resume: Episodes of this run that are there already, or the file that holds them, to be written to with
            ``append=True``: they are left out, but for those that ended in an error, which are run again. The seed is
            theirs; a file that is not there yet holds none.
        progress: Show how far the run is, on standard error; or a callable that does.

    Yields:
        Episodes in order of completion. One whose reset failed has no transitions and an ``error``.

    Raises:
        AgentError: The agent cannot be called, or does not return text.
        ArgumentError: Both a plan and a number of episodes are given, or ``num_envs`` for environments that are there
            already; or what is to be resumed is another run.
        EnvFaultError: An environment failed, and the vector environment has ``on_error="raise"``.
        FaultBudgetError: Environments fail again and again, or the agent does.

    What stops a run is raised behind the episodes that were over by then.
    """
    _check(plan, episodes, max_requests)
    return _run(env, as_agent(agent), _Order(plan, episodes, seed, num_envs, max_requests, resume, progress))


def arollout(
    env: Environments,
    agent: Any,
    *,
    plan: Iterable[PlanItem] | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    num_envs: int | None = None,
    max_requests: int | None = None,
    resume: Resume = None,
    progress: bool | OnProgress = False,
) -> AsyncIterator[Episode]:
    """Let an agent act, and yield each episode as it finishes, for code that runs in an event loop.

    It is used as ``async for episode in arollout(…)``, and does what ``rollout`` does.

    The agent's coroutines run on the caller's loop, beside everything else that does; environments run where their
    backend puts them, and block no loop, those of the backend ``sync`` apart. While the caller does something else
    between two episodes, requests that are open go on, and no slot takes another step.

    Args:
        env: See ``rollout``, as for all that follows.
        agent: Plain or a coroutine function; a plain one blocks the loop while it answers.
        plan: What episodes start from.
        episodes: Number of episodes for each environment.
        seed: Seed of the run.
        num_envs: How many environments run at once.
        max_requests: Questions that are open at once.
        resume: Episodes of this run that are there already.
        progress: Show how far the run is.
    """
    _check(plan, episodes, max_requests)
    return _arun(env, as_agent(agent), _Order(plan, episodes, seed, num_envs, max_requests, resume, progress))


def default_plan(vector: VectorEnv, episodes: int | None = None) -> Sequence[PlanItem]:
    """Return the plan of ``rollout`` without one: rows in order for data sets, a number of episodes for the rest."""
    parts: list[Sequence[PlanItem]] = []
    for env_id, kwargs in vector.entries:
        rows = vector.num_tasks(env_id, kwargs)
        if rows is not None:
            again = episodes is not None and episodes > rows
            endless = again and vector.endless_tasks(env_id, kwargs)
            parts.append(cover_plan(env_id, rows, episodes=episodes, endless=endless, kwargs=kwargs))
        else:
            parts.append(count_plan([env_id], DEFAULT_EPISODES if episodes is None else episodes, kwargs=kwargs))
    # Taken in turn, so that a run that is stopped has some of each.
    return interleaved(parts)


@dataclass
class _Order:
    """What was asked for; see ``rollout``."""

    plan: Iterable[PlanItem] | None
    episodes: int | None
    seed: int | None
    num_envs: int | None
    max_requests: int | None
    resume: Resume
    progress: bool | OnProgress

    def begin(self, vector: VectorEnv, done: Done) -> tuple[EpisodeQueue, Callable[[], None], Callable[[], None]]:
        """Return what episodes start from, what to call for each that is over, and what to call at the end."""
        seed = done.run_seed(self.seed)
        if self.plan is None and self.episodes is None and vector.own_source.planned:
            source = vector.own_source.restarted(seed)
        else:
            plan = default_plan(vector, self.episodes) if self.plan is None else self.plan
            source = new_source(plan, vector.seed if seed is None else seed)
        source.skip(done.starts, done.check)
        return source, *_reporting(self.progress, source.total, len(done.starts))


def _run(env: Environments, agent: Agent, order: _Order) -> Iterator[Episode]:
    done = done_in(order.resume)
    vector, made_here = _as_vector(env, agent, order, plain=True)
    asking = AgentRequests(agent, vector.signal.set, most=order.max_requests)
    end: Callable[[], None] | None = None
    try:
        prepare_agent(agent)
        source, note, end = order.begin(vector, done)
        loop = EpisodeLoop(vector, asking, Reading.of(agent))
        loop.begin(source)
        while not loop.over:
            for episode in loop.advance():
                note()
                yield episode
            vector.wait(loop.has_news)
    finally:
        if end is not None:
            end()
        asking.close()
        if made_here:
            vector.close()


async def _arun(env: Environments, agent: Agent, order: _Order) -> AsyncIterator[Episode]:
    done = await in_thread(done_in, order.resume)
    vector, made_here = await in_thread(lambda: _as_vector(env, agent, order, plain=False))
    asking = AgentRequests(agent, vector.signal.set, most=order.max_requests, loop=asyncio.get_running_loop())
    end: Callable[[], None] | None = None
    try:
        prepared = getattr(agent, "prepare", lambda: None)()
        if inspect.isawaitable(prepared):
            await prepared
        source, note, end = await in_thread(order.begin, vector, done)
        await vector.drain_async()
        loop = EpisodeLoop(vector, asking, Reading.of(agent))
        loop.begin(source)
        while not loop.over:
            for episode in loop.advance():
                note()
                yield episode
            await vector.wait_async(loop.has_news)
    finally:
        if end is not None:
            end()
        await asking.aclose()
        if made_here:
            await in_thread(vector.close)


def _check(plan: Iterable[PlanItem] | None, episodes: int | None, max_requests: int | None) -> None:
    if plan is not None and episodes is not None:
        raise ArgumentError("give either a plan or a number of episodes, not both")
    if episodes is not None and (not isinstance(episodes, int) or episodes < 0):
        raise ArgumentError(f"episodes must be a whole number from 0 up, not {episodes!r}")
    if max_requests is not None and (type(max_requests) is not int or max_requests < 1):
        raise ArgumentError(f"max_requests must be a positive whole number, not {max_requests!r}")


def _as_vector(env: Environments, agent: Agent, order: _Order, *, plain: bool) -> tuple[VectorEnv, bool]:
    if isinstance(env, Sequence):
        num_envs = _asked_at_once(agent, order.max_requests) if order.num_envs is None else order.num_envs
        return make_vec(env, num_envs, seed=order.seed), True
    if order.num_envs is not None:
        raise ArgumentError("num_envs goes with an id: what is made already has its number of environments")
    if isinstance(env, VectorEnv):
        return env, False
    if not isinstance(env, gymnasium.Env):
        raise ArgumentError(f"rollout takes a vector environment, an environment, an id or several, not {env!r:.200}")
    return around(env, seed=order.seed, keep_open=True, plain=plain), True


def _asked_at_once(agent: Agent, max_requests: int | None) -> int | None:
    """Return how many episodes keep an agent busy; None for a plain one, which is asked one question at a time."""
    most = max_requests or getattr(agent, "max_concurrency", None)
    return most or (DEFAULT_REQUESTS if is_asynchronous(agent) else None)


def _reporting(
    progress: bool | OnProgress, total: int | None, already: int
) -> tuple[Callable[[], None], Callable[[], None]]:
    """Return what to call for each episode that is over, and what to call at the end."""
    if not progress:
        return lambda: None, lambda: None
    count = already
    if callable(progress):
        report, end = progress, lambda: None
    else:
        from gem_core.progress import shown_progress

        report, end = shown_progress(total)

    def note() -> None:
        nonlocal count
        count += 1
        report(count, total)

    report(count, total)
    return note, end
