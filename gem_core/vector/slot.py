"""``Slot``: holds one environment, runs it as its ``concurrency`` requires, and replaces it when it fails."""

from __future__ import annotations

import asyncio
import concurrent.futures
import threading
from collections.abc import Callable, Collection, Coroutine, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast, get_args

from gem_core.background import DaemonPool, in_thread, on_library_loop, within
from gem_core.docs import page_url
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import (
    BridgeError,
    ClosedError,
    EnvFaultError,
    FaultBudgetError,
    NotSupportedError,
)
from gem_core.records.plans import EpisodeStart
from gem_core.types import Action, Concurrency, ResetResult, StepResult
from gem_core.vector.failures import Failure, WorkerFailureError
from gem_core.vector.remote import RemoteEnv
from gem_core.vector.runner import EnvRunner
from gem_core.vector.setup import Autoreset, OnError

T = TypeVar("T")

MOST_ABANDONED = 64
"""Number of hanging threads at which a run is stopped."""

ALL_IN_PLACE: Collection[str] = get_args(Concurrency)


class FaultBudget:
    """Counts faults in a row, with no finished episode between them; shared by all slots.

    Args:
        limit: Number of faults in a row that is allowed.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.total = 0
        """Number of faults so far."""
        self._in_a_row = 0

    def note(self, error: Any, what: str, cause: BaseException | None = None) -> None:
        """Count how an episode ended.

        Args:
            error: ``info["error"]``, or None.
            what: Name of the environment.
            cause: The exception, if there was one.

        Raises:
            FaultBudgetError: The limit is exceeded; its cause is the exception of the last fault.
        """
        if error is None:
            self._in_a_row = 0
            return
        told = error if isinstance(error, Mapping) else {"message": str(error)}
        if told.get("kind") == "collateral":
            return  # the fault of another slot, which is counted there
        self.total += 1
        self._in_a_row += 1
        if self._in_a_row > self.limit:
            advice = "Mend the environment; episode.error['frames'] of each episode shows the lines that failed"
            if told.get("kind") == "agent":
                advice = "It is the agent that fails, or the server that it asks, not the environment"
            where = f" ({told['frames'][-1]})" if told.get("frames") else ""
            raise FaultBudgetError(
                f"{self._in_a_row} faults in a row without one finished episode; the last, in {what}: "
                f"{told.get('message', error)}{where}. {advice}. See {page_url('vector-environments/#faults')}"
            ) from cause


@dataclass
class VectorConfig:
    """The settings that all slots of a vector environment share.

    Args:
        make: Makes the environment of a slot: called with its number, the id and the keyword arguments.
        budget: Count of faults.
        in_place: Values of ``concurrency`` that run in the caller's thread; the others run in threads and tasks.
        is_quick: Tells whether making the environment of an id may run in the caller's thread, too.
        autoreset: See ``make_vec``.
        on_error: ``"truncate"`` or ``"raise"``.
        step_timeout: Seconds that a reset or a step may take; None for no limit.
    """

    make: Callable[[int, str | None, Mapping[str, Any]], AnyEnv]
    budget: FaultBudget
    in_place: Collection[str] = ("inline",)
    is_quick: Callable[[str | None], bool] = lambda env_id: True
    autoreset: Autoreset = "same_step"
    on_error: OnError = "truncate"
    step_timeout: float | None = None
    pool: DaemonPool = field(default_factory=lambda: DaemonPool("gem-env"))
    lock: threading.Lock = field(default_factory=threading.Lock)
    busy: set[EnvRunner] = field(default_factory=set)
    """Runners that a thread is in; the lock protects who closes an abandoned one."""


class Slot:
    """Holds one environment at a time; ``reset`` makes it, and makes another when it has failed.

    An exception of the environment, or a step that takes too long, comes back as a ``Failure``. The coroutines run on
    any event loop. If ``in_place`` is true, they never wait, so that plain code finishes them at once.

    Args:
        index: Number of the slot.
        env_id: Id of the environment if the plan names none; None for an environment without an id.
        kwargs: Keyword arguments of that environment, which override those of the run.
        config: Settings that all slots share.
        borrowed: An environment that the caller owns and closes.
    """

    def __init__(
        self,
        index: int,
        env_id: str | None,
        kwargs: Mapping[str, Any],
        config: VectorConfig,
        borrowed: AnyEnv | None = None,
    ) -> None:
        self.index, self.env_id, self.kwargs, self.config, self.borrowed = index, env_id, kwargs, config, borrowed
        self.start: EpisodeStart | None = None
        """The start of the present episode."""
        self.is_joint = False
        """Whether several agents act in the present episode."""
        self.cause: BaseException | None = None
        """The exception of the last fault, until that is counted."""
        self.runner = self._new_runner()

    @property
    def in_place(self) -> bool:
        """Whether the present environment runs in the caller's thread."""
        runner = self.runner
        return runner.concurrency in self.config.in_place and not isinstance(runner.env, RemoteEnv)

    def name(self) -> str:
        """Return the name that errors use for this slot's environment."""
        return str((self.start.item.id if self.start is not None else None) or self.env_id or f"slot {self.index}")

    def target(self, start: EpisodeStart) -> tuple[str | None, Mapping[str, Any]]:
        """Return the id and the keyword arguments of the environment that an episode needs."""
        item = start.item
        kwargs = {**self.kwargs, **item.kwargs} if self.kwargs and item.id is None else item.kwargs
        return item.id or self.env_id, kwargs

    def fits(self, start: EpisodeStart) -> bool:
        """Tell whether the present environment is that of an episode."""
        return self.runner.has_env_for(*self.target(start))

    def prepares_in_place(self, start: EpisodeStart) -> bool:
        """Tell whether ``prepare`` never waits."""
        return self.fits(start) or self.config.is_quick(self.target(start)[0])

    async def prepare(self, start: EpisodeStart) -> Failure | None:
        """Make the environment that an episode needs unless it is there; return the failure, if any."""
        env_id, kwargs = self.target(start)
        if self.config.is_quick(env_id):
            return self.runner.make(env_id, kwargs)
        if self.runner.has_env_for(env_id, kwargs):
            return None
        return await self._limited(self._make(env_id, kwargs))

    async def reset(self, start: EpisodeStart, options: Mapping[str, Any] | None = None) -> ResetResult | Failure:
        """Begin an episode, in a new environment if the present one was made for another id or other arguments.

        Args:
            start: Start of the episode.
            options: For ``reset``; options of the plan's item override them.
        """
        env_id, kwargs = self.target(start)
        self.start = start
        item = start.item
        options = {**(options or {}), **(item.options or {})} if options or item.options else None
        if self.in_place and self.runner.has_env_for(env_id, kwargs):
            outcome = self.runner.reset(start.seed, options)
        else:
            outcome = await self._limited(self._reset(env_id, kwargs, start.seed, options))
        if not isinstance(outcome, Failure):
            info = outcome[1]
            self.is_joint = "possible_agents" in info
            info["seed"] = start.seed
            if item.group is not None:
                info["group"] = item.group
        return outcome

    async def step(self, action: Action) -> StepResult | Failure:
        """Step the environment."""
        if self.in_place:
            return self.runner.step(action)
        return await self._limited(self._step(action))

    def sample_random_action(self, agent: str | None = None) -> str:
        """Return a valid action for the present state; an empty one before the first reset.

        Raises:
            SamplingNotSupported: The environment cannot sample actions.
            EnvFaultError: The environment failed.
        """
        seed = None if self.start is None else self.start.action_seed
        try:
            return self.runner.sample_random_action(seed, agent)
        except (NotSupportedError, BridgeError, ClosedError):
            raise
        except WorkerFailureError as error:
            if isinstance(error.failure.error, NotSupportedError):
                raise error.failure.error from None
            raise EnvFaultError(f"{self.name()}: {error.failure.message}") from error
        except Exception as error:
            what = error if isinstance(error, EnvFaultError) else Failure.of(error, "sample_random_action").message
            raise EnvFaultError(f"{self.name()}: {what}") from error

    def abandon_if_busy(self) -> None:
        """Abandon the environment if a thread is in it."""
        if self.runner in self.config.busy:
            self._abandon(self.runner)

    async def release(self) -> None:
        """Close the environment, which is no longer needed; the caller's own stays for the next run."""
        if self.runner.env is None or self.runner.env is self.borrowed:
            return
        if self.in_place:
            self.runner.close()
        else:
            await in_thread(self.runner.close)

    async def _make(self, env_id: str | None, kwargs: Mapping[str, Any]) -> Failure | None:
        runner = self.runner
        if self.config.is_quick(env_id):
            return runner.make(env_id, kwargs)
        return await self._in_thread(runner, runner.make, env_id, kwargs)

    async def _reset(
        self, env_id: str | None, kwargs: Mapping[str, Any], seed: int, options: dict[str, Any] | None
    ) -> ResetResult | Failure:
        if not self.runner.has_env_for(env_id, kwargs) and (failure := await self._make(env_id, kwargs)):
            return failure
        runner = self.runner
        if self.in_place:
            return runner.reset(seed, options)
        if runner.concurrency == "async":
            return await on_library_loop(runner.reset_async(seed, options))
        return await self._in_thread(runner, runner.reset, seed, options)

    async def _step(self, action: Action) -> StepResult | Failure:
        runner = self.runner
        if runner.concurrency == "async":
            return await on_library_loop(runner.step_async(action))
        return await self._in_thread(runner, runner.step, action)

    async def _limited(self, work: Coroutine[Any, Any, T]) -> T | Failure:
        """Await work of the environment for ``step_timeout`` at most; a worker keeps that limit itself."""
        runner, limit = self.runner, self.config.step_timeout
        try:
            return await (work if limit is None or isinstance(runner.env, RemoteEnv) else within(limit, work))
        except asyncio.CancelledError:
            self._abandon(runner)
            raise
        except TimeoutError:
            self._abandon(runner)
        failure = Failure("timeout", f"a step or reset took longer than step_timeout, {limit:g} s")
        hanging = sum(each.abandoned for each in self.config.busy.copy())
        if hanging > MOST_ABANDONED:
            raise FaultBudgetError(
                f"{hanging} environments hang in threads that cannot be ended; the last: {failure.message}. "
                "Use backend='process', whose workers can be killed"
            )
        return failure

    async def _in_thread(self, runner: EnvRunner, work: Callable[..., T], *args: Any) -> T:
        """Run blocking work in a thread of the pool."""
        future: concurrent.futures.Future[T] = concurrent.futures.Future()
        future.set_running_or_notify_cancel()  # it cannot be cancelled between a look at it and its result

        def run() -> None:
            outcome = None if runner.abandoned else work(*args)
            with self.config.lock:
                self.config.busy.discard(runner)
            if runner.abandoned:
                runner.close()
            else:
                future.set_result(cast("T", outcome))

        self.config.busy.add(runner)
        self.config.pool.submit(run)
        return await asyncio.wrap_future(future)

    def _abandon(self, runner: EnvRunner) -> None:
        """Abandon an environment that does not answer; its thread closes it when it comes back."""
        with self.config.lock:
            runner.abandoned = True
            busy = runner in self.config.busy
        if not busy:
            self.config.pool.submit(runner.close)
        self.runner = self._new_runner()

    def _new_runner(self) -> EnvRunner:
        index, make = self.index, self.config.make
        return EnvRunner(lambda env_id, kwargs: make(index, env_id, kwargs), self.borrowed)

    def fault(self, failure: Failure) -> dict[str, Any]:
        """Return ``info["error"]`` of a failure; raise it if ``on_error`` says so.

        Raises:
            EnvFaultError: ``on_error`` is ``"raise"``.
        """
        if failure.permanent and failure.error is not None:
            raise failure.error
        raised = failure.raised(self.name())
        if self.config.on_error == "raise":
            raise raised
        self.cause = failure.error or raised
        return failure.info()

    def note_end(self, error: Any, cause: BaseException | None = None) -> None:
        """Count how an episode ended, in the budget of faults that all slots share; see ``FaultBudget.note``."""
        cause, self.cause = cause or self.cause, None
        self.config.budget.note(error, self.name(), cause)
