"""``Slot``: holds one environment, runs it as its ``concurrency`` requires, and replaces it when it fails."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_args

from gem_core.background import DaemonPool, in_thread, on_library_loop, within
from gem_core.docs import page_url
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import BridgeError, ClosedError, EnvFaultError, FaultBudgetError, NotSupportedError
from gem_core.failures import Failure, WorkerFailureError
from gem_core.records.plans import EpisodeStart
from gem_core.types import TERMINAL_STATE, Action, Concurrency, Info, Observation, ResetResult, StepResult
from gem_core.vector.joint import lost_step
from gem_core.vector.remote import RemoteEnv
from gem_core.vector.runner import EnvRunner
from gem_core.vector.setup import Autoreset, OnError

if TYPE_CHECKING:
    import concurrent.futures

T = TypeVar("T")

NEW, LIVE, ENDED, IDLE, BROKEN = "new", "live", "ended", "idle", "broken"
"""Phases of a slot: before the first episode; in an episode; after one, before the next begins; without an episode,
since the plan is exhausted; without an environment, since an error was raised."""

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
    threads: DaemonPool = field(default_factory=lambda: DaemonPool("gem-env"))
    hanging: set[concurrent.futures.Future[Any]] = field(default_factory=set)
    """Calls of abandoned environments that have not come back from their threads."""


class Slot:
    """Holds one environment at a time, and the state of its episode.

    ``make`` makes the environment that an episode needs, if it is not there or has failed. An exception of the
    environment, or a step that takes too long, comes back as a ``Failure``. The coroutines run on any event loop. If
    ``in_place`` is true, they never wait, so that plain code finishes them at once.

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
        self.runner = self._new_runner()
        self._call: concurrent.futures.Future[Any] | None = None
        """The last call of the environment in a thread."""
        self.start: EpisodeStart | None = None
        """The start of the present episode."""
        self.is_joint = False
        """Whether several agents act in the present episode."""
        self.cause: BaseException | None = None
        """The exception of the last fault, until that is counted."""
        # For ``VectorEnv``; a rollout keeps an episode's state in its record.
        self.phase = NEW
        self.busy = False
        """Whether the environment is at work elsewhere."""
        self.result: Any = None
        """The five values of the last step or reset, or an exception."""
        self._last_step: StepResult | None = None
        """Of an episode that has ended, until the next has begun."""
        self._failed_resets: list[dict[str, Any]] = []
        """The resets that failed since then."""

    @property
    def in_place(self) -> bool:
        """Whether the present environment runs in the caller's thread."""
        return self.runner.in_place

    def name(self) -> str:
        """Return the name that errors use for this slot's environment."""
        return str((self.start.item.id if self.start is not None else None) or self.env_id or f"slot {self.index}")

    def target(self, start: EpisodeStart) -> tuple[str | None, Mapping[str, Any]]:
        """Return the id and the keyword arguments of the environment that an episode needs."""
        item = start.item
        kwargs = {**self.kwargs, **item.kwargs} if self.kwargs and item.id is None else item.kwargs
        return item.id or self.env_id, kwargs

    # Running the environment.

    def fits(self, start: EpisodeStart) -> bool:
        """Tell whether the present environment is that of an episode."""
        return self.runner.has_env_for(*self.target(start))

    def makes_in_place(self, start: EpisodeStart) -> bool:
        """Tell whether ``make`` never waits."""
        return self.config.is_quick(start.item.id or self.env_id)

    async def make(self, start: EpisodeStart) -> Failure | None:
        """Make the environment that an episode needs; return the failure, if any."""
        if self.makes_in_place(start):
            return self.runner.make(*self.target(start))
        return await self._elsewhere(self.runner.make, None, *self.target(start))

    async def reset(self, start: EpisodeStart, options: Mapping[str, Any] | None = None) -> ResetResult | Failure:
        """Begin an episode in the environment that ``make`` has made.

        Args:
            start: Start of the episode.
            options: For ``reset``; options of the plan's item override them.
        """
        self.start = start
        item, runner = start.item, self.runner
        options = {**(options or {}), **(item.options or {})} if options or item.options else None
        if runner.in_place:
            outcome = runner.reset(start.seed, options)
        else:
            outcome = await self._elsewhere(runner.reset, runner.reset_async, start.seed, options)
        if not isinstance(outcome, Failure):
            info = outcome[1]
            self.is_joint = "possible_agents" in info
            info["seed"] = start.seed
            if item.group is not None:
                info["group"] = item.group
        return outcome

    async def step(self, action: Action) -> StepResult | Failure:
        """Step the environment."""
        runner = self.runner
        return runner.step(action) if runner.in_place else await self._elsewhere(runner.step, runner.step_async, action)

    def sample_random_action(self, agent: str | None = None) -> str:
        """Return a valid action for the present state; an empty one before the first reset.

        Raises:
            SamplingNotSupported: The environment cannot sample actions.
            EnvFaultError: The environment failed.
        """
        try:
            return self.runner.sample_random_action(None if self.start is None else self.start.action_seed, agent)
        except Exception as error:
            what = "sample_random_action"
            failure = error.failure if isinstance(error, WorkerFailureError) else Failure.of(error, what)
            if isinstance(failure.error, NotSupportedError | BridgeError | ClosedError):
                raise failure.error from None
            raise EnvFaultError(f"{self.name()}: {failure.message}") from error

    async def release(self) -> None:
        """Close the environment, which is no longer needed; the caller's own stays for the next run."""
        if self.runner.env is None or self.runner.env is self.borrowed:
            return
        if self.in_place:
            self.runner.close()
        else:
            await in_thread(self.runner.close)

    async def _elsewhere(
        self, plain: Callable[..., T], coroutine: Callable[..., Awaitable[T]] | None, *args: Any
    ) -> T | Failure:
        """Call a method of the runner in a thread, or as a task if the environment is asynchronous.

        It may take ``step_timeout``, a limit that a worker keeps itself.
        """
        runner = self.runner
        work: Awaitable[T]
        if coroutine is not None and runner.concurrency == "async":
            work = on_library_loop(coroutine(*args))
        else:
            self._call = self.config.threads.submit(plain, *args)
            work = asyncio.wrap_future(self._call)
        limit = None if isinstance(runner.env, RemoteEnv) else self.config.step_timeout
        try:
            return await (work if limit is None else within(limit, work))
        except asyncio.CancelledError:
            self._abandon(runner)
            raise
        except TimeoutError:
            self._abandon(runner)
        failure = Failure.timeout(cast("float", limit))
        if len(self.config.hanging) > MOST_ABANDONED:
            raise FaultBudgetError(
                f"{len(self.config.hanging)} environments hang in threads that cannot be ended; the last: "
                f"{failure.message}. Use backend='process', whose workers can be killed"
            )
        return failure

    def abandon_if_busy(self) -> None:
        """Abandon the environment if a thread is in it."""
        if self._call is not None and not self._call.done():
            self._abandon(self.runner)

    def _abandon(self, runner: EnvRunner) -> None:
        """Replace an environment that does not answer; it is closed when its thread has come back."""
        if self.runner is not runner:
            return
        call, self._call, self.runner = self._call, None, self._new_runner()
        if call is None or call.done():
            self.config.threads.submit(runner.close)
            return
        if not isinstance(runner.env, RemoteEnv):  # the pool of workers counts those itself
            self.config.hanging.add(call)
        call.add_done_callback(self.config.hanging.discard)
        call.add_done_callback(lambda _: runner.close())
        call.cancel()

    def _new_runner(self) -> EnvRunner:
        return EnvRunner(partial(self.config.make, self.index), self.borrowed, self.config.in_place)

    # Faults.

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

    # From result to result, for ``VectorEnv``.

    def clear(self) -> None:
        """Forget the last episode."""
        self._last_step, self._failed_resets = None, []

    def take_step(self, outcome: Any) -> bool:
        """Store the outcome of a step, or its exception; tell whether the next episode begins now."""
        try:
            if type(outcome) is not tuple:
                if isinstance(outcome, BaseException):
                    raise outcome
                outcome = lost_step(self.fault(outcome), joint=self.is_joint)
            self.result = outcome
            if not (outcome[2] or outcome[3]):
                return False
            self.note_end(outcome[4].get("error"))
        except Exception as raised:  # noqa: BLE001 - raised again when the result is returned
            self.phase, self.result = BROKEN, raised
            return False
        self.phase = ENDED
        if self.config.autoreset == "same_step":
            self._last_step = outcome
        return self._last_step is not None

    def take_reset(self, start: EpisodeStart, outcome: Any) -> bool:
        """Store the outcome of a reset, or its exception; tell whether the plan's next episode must be tried."""
        try:
            if isinstance(outcome, BaseException):
                raise outcome
            if isinstance(outcome, Failure):
                error = self.fault(outcome)
                self._failed_resets.append(self._failed_reset(start, error))
                self.note_end(error)
                return True
        except Exception as raised:  # noqa: BLE001 - raised again when the result is returned
            self.phase, self.result = BROKEN, raised
            return False
        self.phase = LIVE
        self._take_first(*outcome)
        return False

    def take_idle(self) -> None:
        """Go without an episode."""
        self.phase, self.is_joint = IDLE, False
        self._take_first(TERMINAL_STATE, {"idle": True})

    def _take_first(self, observation: Observation, info: Info) -> None:
        if self._failed_resets:
            info["failed_resets"] = self._failed_resets
        last = self._last_step
        if last is None:
            self.result = (observation, {} if isinstance(observation, dict) else 0.0, False, False, info)
        else:
            info["final_obs"], info["final_info"] = last[0], last[4]
            self.result = (observation, *last[1:4], info)
        self.clear()

    def _failed_reset(self, start: EpisodeStart, error: dict[str, Any]) -> dict[str, Any]:
        """Return the entry of ``info["failed_resets"]`` for one reset that failed."""
        env_id, kwargs = self.target(start)
        return {
            "id": env_id,
            "kwargs": dict(kwargs),
            "options": None if start.item.options is None else dict(start.item.options),
            "seed": start.seed,
            "run_seed": start.run_seed,
            "group": start.item.group,
            "agent": start.item.agent,
            "key": start.key,
            "repeat": start.repeat,
            "error": error,
        }
