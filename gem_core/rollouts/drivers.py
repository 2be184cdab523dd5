"""``rollout`` and ``arollout``: an agent acts in environments, and each episode comes out as it finishes."""

from __future__ import annotations

import asyncio
import inspect
import itertools
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict, TypeVar, Unpack, overload

import gymnasium

from gem_core.background import Door, in_thread, on_background_loop, run_or_schedule
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError
from gem_core.progress import Progress
from gem_core.records.episode import Episode
from gem_core.records.joint import JointEpisode, Record
from gem_core.records.plans import EpisodeQueue, LazyPlan, PlanItem, count_plan, cover_plan, interleaved
from gem_core.rollouts.agent import Agent, close_agent, is_asynchronous, prepare_agent
from gem_core.rollouts.loop import Run, play_here
from gem_core.rollouts.resume import FinishedEpisodes, finished_episodes
from gem_core.rollouts.seating import AgentOfItem, OneAgent, Seating, as_seating
from gem_core.vector.backends import make_vector
from gem_core.vector.setup import Backend, IdOrIds
from gem_core.vector.vector_env import VectorEnv

T = TypeVar("T")

DEFAULT_EPISODES = 10
DEFAULT_REQUESTS = 64

Environments = VectorEnv | AnyEnv | IdOrIds
"""A vector environment, an environment, an id or several."""

Resume = str | Path | Iterable[Record] | FinishedEpisodes | None
"""A file of episodes, or the episodes; or what ``finished_episodes`` found there."""

OnProgress = Callable[[int, int | None], None]
"""Called with the number of finished episodes, and the number of all or None if unknown."""


class RolloutOptions(TypedDict, total=False):
    """The keyword arguments of ``rollout`` besides who acts; see there."""

    plan: Iterable[PlanItem] | None
    episodes: int | None
    seed: int | None
    num_envs: int | None
    backend: Backend
    max_requests: int | None
    resume: Resume
    progress: bool | OnProgress


@overload
def rollout(env: Environments, agent: Any, **options: Unpack[RolloutOptions]) -> Iterator[Episode]: ...
@overload
def rollout(env: Environments, *, agents: Any, **options: Unpack[RolloutOptions]) -> Iterator[JointEpisode]: ...
def rollout(
    env: Environments,
    agent: Any = None,
    *,
    agents: Any = None,
    plan: Iterable[PlanItem] | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    num_envs: int | None = None,
    backend: Backend = "auto",
    max_requests: int | None = None,
    resume: Resume = None,
    progress: bool | OnProgress = False,
) -> Iterator[Any]:
    """Let an agent act, or several agents together, and yield each episode as it finishes.

    The plan and the seed fix the episodes, whatever the number of slots, the backend, and the order of completion.

    A plain agent is asked for one slot after another. An asynchronous agent is asked for each slot and seat as soon as
    it is ready, so that a slow answer or a slow environment delays only its own slot. While the caller looks at an
    episode, slots finish at most the episode that they are in.

    Args:
        env: A vector environment, an environment, an id or several. An environment that is given stays open at the end.
        agent: Called as ``agent(observation, context)``, or with the observation alone; plain or a coroutine function.
            It returns a ``str`` or a ``Response``. Or the name of an agent, as ``load_agent`` takes it, ``"random"`` or
            ``"openai:MODEL"``, which is then closed at the end. Or several, ``{name: agent}``, each for the items of
            the plan that name it (``PlanItem.agent``): models compared in one run.
        agents: Instead of ``agent``, for environments of several agents: ``{seat: agent}``; or a list of one agent for
            each seat, which move on by one seat from item to item of the plan, so that each begins equally often; or
            one agent for all seats, as in self-play; or a ``League``. Each may be given by name, as ``agent`` may.
        plan: Items that episodes start from; see ``gem_core.records.plans``.
        episodes: Instead of a plan, the number of episodes for each environment; a data set gives its first rows. With
            neither, the run takes the vector environment's own plan from the beginning. If there is none, it plays each
            row of a data set once, and ten episodes of an environment without rows.
        seed: Seed of the run; None takes the vector environment's, or draws one.
        num_envs: With ids, how many environments run at once. By default, as many as the agent takes questions at
            once: ``max_requests``, else its ``max_concurrency``, else 64 for an asynchronous agent and one for each id
            for a plain one. Of several agents, the largest number decides.
        backend: With ids, the place that environments run in; see ``make_vec``.
        max_requests: Largest number of open questions to asynchronous agents; None for no limit.
        resume: Finished episodes of this run, or their file, to which new ones are appended. They are not played again,
            except episodes that ended in an error. Their seed is the run's. The file need not exist yet.
        progress: Show the run's progress on standard error; or a callable that does.

    Yields:
        Episodes in order of completion: an ``Episode``, or with ``agents`` a ``JointEpisode``, which holds the episode
        of each seat. One whose reset failed has no transitions and an ``error``.

    Raises:
        AgentError: An agent cannot be called, or does not return text.
        ArgumentError: Both a plan and a number of episodes are given, or ``num_envs`` without ids; or ``resume`` holds
            another run; or ``agents`` do not fit the seats of an environment.
        EnvFaultError: An environment failed, and the vector environment has ``on_error="raise"``.
        FaultBudgetError: Environments fail again and again, or an agent does.

    An error that stops a run is raised after the episodes that finished before it.
    """
    seating = _seating(agent, agents)
    return _episodes(_Options(env, seating, plan, episodes, seed, num_envs, backend, max_requests, resume, progress))


@overload
def arollout(env: Environments, agent: Any, **options: Unpack[RolloutOptions]) -> AsyncIterator[Episode]: ...
@overload
def arollout(env: Environments, *, agents: Any, **options: Unpack[RolloutOptions]) -> AsyncIterator[JointEpisode]: ...
def arollout(
    env: Environments, agent: Any = None, *, agents: Any = None, **options: Unpack[RolloutOptions]
) -> AsyncIterator[Any]:
    """Let agents act, and yield each episode as it finishes, for code that runs in an event loop.

    It is used as ``async for episode in arollout(…)``, and does what ``rollout`` does.

    The agents' coroutines run on the caller's loop. Environments run in the place of their backend; only the backend
    ``sync`` blocks the loop. While the caller looks at an episode, slots finish at most the episode that they are in.

    Args:
        env: See ``rollout``.
        agent: Plain or a coroutine function; a plain one blocks the loop while it answers.
        agents: Instead of ``agent``, if several agents act.
        **options: The other arguments of ``rollout``.
    """
    return _episodes_async(_Options(env, _seating(agent, agents), **options))


def default_plan(vector: VectorEnv, episodes: int | None = None) -> LazyPlan:
    """Return the plan of ``rollout`` without one: rows in order for data sets, a number of episodes for the rest."""
    parts: list[LazyPlan] = []
    for env_id, kwargs in vector.entries:
        rows, endless = vector.tasks(env_id, kwargs)
        if rows is not None:
            parts.append(cover_plan(env_id, rows, episodes=episodes, endless=endless, kwargs=kwargs))
        else:
            parts.append(count_plan([env_id], DEFAULT_EPISODES if episodes is None else episodes, kwargs=kwargs))
    # Taken in turn, so that a run that is stopped has some of each.
    return interleaved(parts)


@dataclass
class _Options:
    """The arguments of one call of ``rollout``."""

    env: Environments
    seating: Seating
    plan: Iterable[PlanItem] | None = None
    episodes: int | None = None
    seed: int | None = None
    num_envs: int | None = None
    backend: Backend = "auto"
    max_requests: int | None = None
    resume: Resume = None
    progress: bool | OnProgress = False

    def __post_init__(self) -> None:
        if self.plan is not None and self.episodes is not None:
            raise ArgumentError("give either a plan or a number of episodes, not both")
        if self.episodes is not None and (not isinstance(self.episodes, int) or self.episodes < 0):
            raise ArgumentError(f"episodes must be a whole number from 0 up, not {self.episodes!r}")
        if self.max_requests is not None and (type(self.max_requests) is not int or self.max_requests < 1):
            raise ArgumentError(f"max_requests must be a positive whole number, not {self.max_requests!r}")

    @property
    def agents(self) -> list[Agent]:
        """Every agent that may act, as far as known, each once."""
        return list({id(agent): agent for agent in self.seating.agents()}.values())

    def close_loaded(self) -> None:
        """Close the agents that were given by name, also the ones that a league got during the run."""
        with ExitStack() as closing:
            for agent in self.seating.loaded:
                closing.callback(close_agent, agent)

    def vector(self, *, plain: bool) -> VectorEnv:
        """Return the vector environment in which the episodes run: the one given, or a new one.

        Args:
            plain: Run an environment that was given in the calling thread.
        """
        if isinstance(self.env, Sequence):
            num_envs = _asked_at_once(self.agents, self.max_requests) if self.num_envs is None else self.num_envs
            return make_vector(self.env, num_envs, backend=self.backend, seed=self.seed)
        if self.num_envs is not None:
            raise ArgumentError("num_envs goes with an id: an environment that is made already has its number of slots")
        if self.backend != "auto":
            raise ArgumentError("backend goes with an id: an environment that is made already has its place")
        if isinstance(self.env, VectorEnv):
            return self.env
        if not isinstance(self.env, gymnasium.Env):
            raise ArgumentError(
                f"rollout takes a vector environment, an environment, an id or several, not {self.env!r:.200}"
            )
        return VectorEnv.from_env(self.env, seed=self.seed, keep_open=True, plain=plain)

    def queue(self, vector: VectorEnv, finished: FinishedEpisodes) -> EpisodeQueue:
        """Return the queue of the episodes that are not finished."""
        seed = finished.run_seed(self.seed)
        if self.plan is None and self.episodes is None and vector.plan.plan is not None:
            queue = vector.plan.restarted(seed)
        else:
            plan = default_plan(vector, self.episodes) if self.plan is None else self.plan
            queue = EpisodeQueue(plan, vector.seed if seed is None else seed)
        if len(finished):
            finished.leave_out_of(queue)
        return queue

    def counting(self, at_end: ExitStack | AsyncExitStack, queue: EpisodeQueue, done: int) -> Callable[[], None]:
        """Show the progress until the end; return a function to call for each episode that finishes."""
        if not self.progress:
            return lambda: None
        total, counts = queue.total, itertools.count(done)
        bar = at_end.enter_context(Progress(total, "episodes", quiet=callable(self.progress)))
        report = self.progress if callable(self.progress) else lambda count, total: bar.advance(count)
        report(next(counts), total)
        return lambda: report(next(counts), total)


def _episodes(options: _Options) -> Iterator[Record]:
    """Yield the episodes of ``rollout``."""
    door, at_end = Door(), ExitStack()
    try:
        finished = finished_episodes(options.resume)
        vector = options.vector(plain=True)
        if vector is not options.env:
            at_end.callback(vector.close)
        at_end.callback(options.close_loaded)
        agents = options.agents
        for agent in agents:
            prepare_agent(agent)
        queue = options.queue(vector, finished)
        count = options.counting(at_end, queue, len(finished))
        is_plain = not any(map(is_asynchronous, agents))
        run = Run(vector, queue, options.seating, options.max_requests, door.here, is_plain)
        at_end.callback(lambda: door.run(run.stop()) if run.tasks else None)
        for episode in _records(run, door):
            count()
            yield episode
    finally:
        if on_background_loop():  # the generator is collected there, where nothing can wait
            door.interrupted = True
            run_or_schedule(in_thread(at_end.close))
        else:
            at_end.close()


def _records(run: Run, door: Door) -> Iterator[Record]:
    if run.is_plain:
        yield from play_here(run)
        if not run.drawn:
            return
    while (record := door.run(run.next_record())) is not None:
        yield record


async def _episodes_async(options: _Options) -> AsyncGenerator[Record]:
    """Yield the episodes of ``arollout``; what may block for long is done in a thread."""
    finished = await in_thread(finished_episodes, options.resume)
    vector: VectorEnv = await in_thread(lambda: options.vector(plain=False))
    async with AsyncExitStack() as at_end:
        if vector is not options.env:
            at_end.push_async_callback(in_thread, vector.close)
        at_end.push_async_callback(in_thread, options.close_loaded)
        for agent in options.agents:
            prepared = getattr(agent, "prepare", lambda: None)()
            if inspect.isawaitable(prepared):
                await prepared
        queue = await in_thread(options.queue, vector, finished)
        count = options.counting(at_end, queue, len(finished))
        run = Run(vector, queue, options.seating, options.max_requests, _soon, is_plain=False)
        at_end.push_async_callback(run.stop)
        while (episode := await run.next_record()) is not None:
            count()
            yield episode


async def _soon(function: Callable[..., T], *args: Any) -> T:
    """Call plain code, after the turn of all that is ready."""
    await asyncio.sleep(0)
    return function(*args)


def _seating(agent: Any, agents: Any) -> Seating:
    """Return the rule that says which agents play an episode."""
    if (agent is None) == (agents is None):
        raise ArgumentError("give either agent, for one agent, or agents, for several")
    if agents is not None:
        return as_seating(agents)
    return AgentOfItem(agent) if isinstance(agent, Mapping) else OneAgent(agent)


def _asked_at_once(agents: Iterable[Agent], max_requests: int | None) -> int | None:
    """Return how many episodes keep agents busy; None for plain ones, which are asked one question at a time."""
    wanted = (getattr(agent, "max_concurrency", None) or is_asynchronous(agent) * DEFAULT_REQUESTS for agent in agents)
    return max_requests or max(wanted, default=0) or None
