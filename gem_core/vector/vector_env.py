"""``VectorEnv``: many environments that are reset and stepped together, in any backend."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
from collections.abc import Awaitable, Callable, Collection, Coroutine, Iterable, Mapping, Sequence
from contextlib import suppress
from types import MappingProxyType
from typing import Any, Self, TypeVar, cast

import numpy as np
import numpy.typing as npt

from gem_core.background import background_loop, on_library_loop, run_without_loop
from gem_core.closing import CLOSING_S, close_all, wait_for_closing
from gem_core.docs import page_url
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, ClosedError, EnvFaultError, GemError, ResetNeededError
from gem_core.failures import Failure, WorkerFailureError
from gem_core.making.again import Recipe
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.types import Action, Info, Observation
from gem_core.vector.actions import Actions, Received, VectorStep, check_action, checked_slot, masked_slots, paired
from gem_core.vector.remote import RemoteEnv, WorkerPool
from gem_core.vector.setup import Autoreset, OnError, VectorSetup
from gem_core.vector.slot import (
    ALL_IN_PLACE,
    BROKEN,
    ENDED,
    IDLE,
    LIVE,
    NEW,
    FaultBudget,
    Slot,
    VectorConfig,
)

logger = logging.getLogger("gem_core")

T = TypeVar("T")

_OWN_METHODS = ("close", "reset", "reset_async", "step", "step_async")


class VectorEnv:
    """Many environments that are reset and stepped together, each in its own slot; ``make_vec`` makes one.

    It is not a ``gymnasium.vector.VectorEnv``: texts and infos are lists. ``call`` asks every environment for anything.

    When an episode ends, the next begins in the same call (autoreset ``same_step``): the observation is the first of
    the new episode, and ``info["final_obs"]`` and ``info["final_info"]`` hold the last of the old one. If an
    environment fails, its episode ends as truncated, with ``info["final_info"]["error"]``, and the environment is
    replaced. When a plan is exhausted, a slot is idle: its observation is ``TERMINAL_STATE``, its flags are false,
    ``info["idle"]`` is true, and its actions are ignored.

    If several agents act in a slot, its observation, reward and action are dictionaries by agent. Its flags tell of the
    whole episode; ``info["agents"]`` holds each agent's info, ``info["terminations"]`` and
    ``info["truncations"]`` each agent's flags.

    ``step`` waits for all slots that it stepped; ``send`` does not wait, and ``recv`` returns results as they come.
    Each method that waits has an ``_async`` form, which does not block the event loop; all work in plain code,
    notebooks and servers. An interrupt (Ctrl-C) inside a method closes the vector environment, and so does cancelling
    ``step_async`` or ``reset_async``.

    Args:
        setup: The arguments of ``make_vec``, checked.
        in_place: Values of ``concurrency`` that run in the caller's thread.
        pool: Workers for environments that live in other processes.
        in_pool: Tells whether the environment of an id lives in the pool; by default all do if there is a pool.
        borrowed: The environment of the only slot, which the caller owns and closes.
    """

    entries: list[tuple[str | None, Mapping[str, Any]]]
    """The requested ids with their keyword arguments, each once; there may be more of them than slots."""

    ids: list[str | None]
    """The id of each slot's own environment."""

    def __init__(
        self,
        setup: VectorSetup,
        *,
        in_place: Collection[str] = ("inline",),
        pool: WorkerPool | None = None,
        in_pool: Callable[[str | None], bool] | None = None,
        borrowed: AnyEnv | None = None,
    ) -> None:
        self.ids, self.entries = [env_id for env_id, _ in setup.slots], setup.entries
        self._plan = EpisodeQueue(setup.plan, setup.seed)
        self._queue = self._plan
        self._pool = pool
        self._closed = False
        remote = (lambda env_id: pool is not None) if in_pool is None else in_pool

        def make(slot: int, env_id: str | None, kwargs: Mapping[str, Any]) -> AnyEnv:
            return pool.make(slot, env_id, kwargs) if pool and remote(env_id) else setup.make(env_id, kwargs)

        def is_quick(env_id: str | None) -> bool:
            return remote(env_id) or in_place is ALL_IN_PLACE or setup.task_concurrency(env_id) in in_place

        budget = FaultBudget(max(16, 2 * len(self.ids)) if setup.max_faults is None else setup.max_faults)
        self.config = VectorConfig(
            make, budget, in_place, is_quick, setup.autoreset, setup.on_error, setup.step_timeout
        )
        self.slots = [Slot(index, *own, self.config, borrowed) for index, own in enumerate(setup.slots)]
        """The slots, for ``rollout``."""
        self._sent: set[int] = set()
        """Slots whose results ``recv`` has not returned."""
        self._ready: list[int] = []
        """Those of them that are ready, in order of completion."""
        self._work: set[asyncio.Future[Any]] = set()
        """What is under way on the library's own event loop."""
        self._news, self._waiting = asyncio.Event(), 0
        """Set when there is something new for so many calls of ``recv`` that wait there."""

    @classmethod
    def from_env(
        cls,
        env: AnyEnv,
        *,
        seed: int | None = None,
        on_error: OnError = "truncate",
        keep_open: bool = False,
        plain: bool = True,
    ) -> VectorEnv:
        """Return a vector environment of one slot that uses a given environment.

        If the environment fails, another is made with the same arguments.

        Args:
            env: Environment that the slot begins with.
            seed: Seed of the run; None draws one.
            on_error: ``"truncate"`` or ``"raise"``.
            keep_open: Leave it to the caller to close ``env``; replacements are closed in any case.
            plain: Run it in the calling thread, regardless of its ``concurrency``.
        """
        spares = [env]
        own_id = getattr(env.unwrapped, "env_id", None)  # an environment of Gymnasium has none

        def factory(env_id: str | None, overrides: Mapping[str, Any]) -> AnyEnv:
            if env_id is not None and env_id != own_id:
                raise ArgumentError(f"the plan asks for {env_id!r}, and the environment given is {env}")
            if spares and not overrides:
                return spares.pop()
            return Recipe.of(env).make(**overrides)

        setup = VectorSetup([(own_id, {})], [(own_id, {})], seed=seed, on_error=on_error, factory=factory)
        in_place = ALL_IN_PLACE if plain else ("inline",)
        return cls(setup, in_place=in_place, borrowed=env if keep_open else None)

    # Properties.

    @property
    def num_envs(self) -> int:
        """Number of slots."""
        return len(self.ids)

    @property
    def autoreset(self) -> Autoreset:
        """When the next episode begins; see ``make_vec``."""
        return self.config.autoreset

    @property
    def closed(self) -> bool:
        """Whether ``close`` was called."""
        return self._closed

    @property
    def seed(self) -> int:
        """Seed of the run, from which the seed of each episode is derived."""
        return self._queue.seed

    @property
    def faults(self) -> int:
        """Number of environments that failed so far."""
        return self.config.budget.total

    @property
    def plan(self) -> EpisodeQueue:
        """Queue of episodes of the plan and seed that were given to ``make_vec``; see ``rollout``."""
        return self._plan

    @property
    def under_way(self) -> int:
        """Number of slots with an action or a reset whose result has not been received."""
        return len(self._sent)

    def start_of(self, slot: int) -> EpisodeStart | None:
        """Return the start of a slot's present episode; None when the slot is idle."""
        return self.slots[slot].start

    def describe(self, slot: int) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` (over the registered ones) and ``wrappers`` of the environment in a slot."""
        slot = checked_slot(slot, self.num_envs)
        self._check_open()
        described = self.slots[slot].runner.describe()
        return {**described, "id": described["id"] or self.ids[slot] or "unknown"}

    def tasks(self, env_id: str | None, kwargs: Mapping[str, Any] = MappingProxyType({})) -> tuple[int | None, bool]:
        """Return ``num_tasks`` and ``endless_tasks`` of an environment; see ``Env``.

        Call it before the first ``reset``: it may make the environment in a slot, in place of the present one.
        """
        self._check_open()
        slot = self.slots[self.ids.index(env_id) if env_id in self.ids else 0]
        return self._ask(slot, (env_id or slot.env_id, dict(kwargs)), _tasks)

    def sample_random_action(self, slot: int, agent: str | None = None) -> str:
        """Return a valid action for the present state of a slot; an empty one before its first reset.

        Args:
            slot: Number of the slot.
            agent: Name of the agent that acts, if several do.

        Raises:
            ArgumentError: There is no such slot, or several agents act there and none of them is named.
            SamplingNotSupported: The environment cannot sample actions.
            EnvFaultError: The environment failed.
        """
        slot = checked_slot(slot, self.num_envs)
        self._check_open()
        if self.slots[slot].is_joint and agent is None:
            acting = ", ".join(map(repr, self.slots[slot].result[0]))
            raise ArgumentError(f"several agents act in slot {slot}: name one of {acting}")
        return self.slots[slot].sample_random_action(agent)

    # Methods that wait for all slots.

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[list[Observation], list[Info]]:
        """Begin an episode in every slot.

        Args:
            seed: Start the run over with this seed; None continues the present run.
            options: Passed to the first episode of every slot. ``"reset_mask"``, a bool for each slot, resets only
                some slots, as in Gymnasium; the others return their last observation, with an empty info.

        Returns:
            The observations and the infos, one of each for every slot.

        Raises:
            ArgumentError: The run cannot start over, because its plan is an iterator that has been drawn from; or the
                mask has the wrong form.
            EnvFaultError: An environment failed, and ``on_error`` is ``"raise"``.
            FaultBudgetError: Too many faults in a row.
        """
        return self._run(self._reset(seed, options))

    async def reset_async(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[list[Observation], list[Info]]:
        """``reset`` for code that runs in an event loop, without blocking it."""
        return await self._run_async(self._reset(seed, options))

    async def _reset(self, seed: int | None, options: dict[str, Any] | None) -> tuple[list[Observation], list[Info]]:
        self._check_open()
        if options is not None and not isinstance(options, Mapping):
            raise ArgumentError(f"options must be a mapping of names to values, not {options!r:.200}")
        chosen = list(range(self.num_envs))
        if options and "reset_mask" in options:
            options = dict(options)
            chosen = masked_slots(options.pop("reset_mask"), self.num_envs)
        everything = len(chosen) == self.num_envs
        if seed is not None:
            if not everything:
                raise ArgumentError(
                    "a seed starts the whole run over, so it cannot go with a reset_mask for some slots"
                )
            self._plan = self._plan.restarted(seed)
        if everything:
            await self._drop_sent()
            self._queue = self._plan
            self.config.budget.note(None, "")
        slots = [self.slots[index] for index in chosen]
        self._refuse_busy(slots)
        for slot in slots:
            slot.clear()
        await self._begin(slots, options)
        results = [slot.result for slot in self.slots]
        for index in chosen:
            if isinstance(results[index], BaseException):
                raise results[index]
        observations = [result[0] if isinstance(result, tuple) else "" for result in results]
        began = set(chosen)
        return observations, [result[4] if index in began else {} for index, result in enumerate(results)]

    def step(self, actions: Actions) -> VectorStep:
        """Step all slots, or the slots that a mapping names, and wait for them.

        Episodes that begin in the same call draw from the plan in the order of the slots, not in the order in which
        environments finish.

        Args:
            actions: One for each slot in order; or ``{slot: action}``.

        Returns:
            The results, in the order of the actions.

        Raises:
            ArgumentError: The number of actions is not the number of slots, or a slot does not exist or is under way.
            ResetNeededError: A slot has no episode, and none begins by itself.
            EnvFaultError: An environment failed, and ``on_error`` is ``"raise"``.
            FaultBudgetError: Too many faults in a row.
        """
        return self._run(self._step(actions))

    async def step_async(self, actions: Actions) -> VectorStep:
        """``step`` for code that runs in an event loop, without blocking it."""
        return await self._run_async(self._step(actions))

    async def _step(self, actions: Actions) -> VectorStep:
        pairs = self._checked_pairs(actions)
        await self._advance(pairs)
        return _results(pairs)

    async def _advance(self, pairs: Sequence[tuple[Slot, Action]]) -> None:
        """Step slots, then begin the next episodes of slots whose episode ended."""
        due: list[Slot] = []
        elsewhere = []
        for slot, action in pairs:
            if slot.phase is IDLE:
                slot.take_idle()
            elif slot.phase is not LIVE:
                due.append(slot)  # next_step: this call begins the next episode, and the action is ignored
            elif not slot.runner.in_place:
                elsewhere.append((slot, slot.step, action))
            elif slot.take_step(slot.runner.step(action)):
                due.append(slot)
        if elsewhere:
            for (slot, *_), outcome in zip(elsewhere, await self._side_by_side(elsewhere), strict=True):
                if slot.take_step(outcome):
                    due.append(slot)
        if due:
            await self._begin(sorted(due, key=lambda slot: slot.index), None)

    # Methods that do not wait for all slots.

    def send(self, actions: Actions) -> None:
        """Begin to step all slots, or the slots that a mapping names; ``recv`` returns the results.

        Raises:
            ArgumentError: The number of actions is not the number of slots, or a slot does not exist or is under way.
            ResetNeededError: A slot has no episode, and none begins by itself.
        """
        for slot, action in self._checked_pairs(actions):
            self._sent.add(slot.index)
            if slot.in_place:
                self._run(self._advance_sent(slot, action))
            else:
                asyncio.run_coroutine_threadsafe(self._advance_sent(slot, action), background_loop())

    async def _advance_sent(self, slot: Slot, action: Action) -> None:
        try:
            await self._advance([(slot, action)])
        except Exception as error:  # noqa: BLE001 - raised again when the result is received
            slot.result = error
        self._ready.append(slot.index)
        if self._waiting:
            background_loop().call_soon_threadsafe(self._news.set)

    def recv(self, min_envs: int = 1, timeout: float | None = None) -> Received:
        """Return the results of ``send`` that are ready, in order of completion.

        Args:
            min_envs: Wait for this many results, or for all slots under way if these are fewer.
            timeout: Seconds to wait at most; afterwards the ready results are returned, perhaps none.

        Raises:
            ArgumentError: Nothing is under way.
            EnvFaultError: An environment failed, and ``on_error`` is ``"raise"``.
            FaultBudgetError: Too many faults in a row.
        """
        return self._run(self._recv(min_envs, timeout))

    async def recv_async(self, min_envs: int = 1, timeout: float | None = None) -> Received:
        """``recv`` for code that runs in an event loop, without blocking it."""
        return await self._recv(min_envs, timeout)

    async def _recv(self, min_envs: int, timeout: float | None) -> Received:
        self._check_open()
        if type(min_envs) is not int or min_envs < 0:
            raise ArgumentError(f"min_envs must be a whole number from 0 up, not {min_envs!r}")
        if not self._sent:
            raise ArgumentError("nothing is under way: recv() returns the results of send()")
        await self._wait_for_ready(min_envs, timeout)
        # A failure is raised only after all other results have been received, so that none of them is lost.
        ready = list(self._ready)
        order = [index for index in ready if isinstance(self.slots[index].result, tuple)] or ready[:1]
        for index in order:
            self._ready.remove(index)
            self._sent.discard(index)
        return Received(order, *_results([(self.slots[index], None) for index in order]))

    async def _wait_for_ready(self, count: int, timeout: float | None = None) -> None:
        """Wait until so many slots are ready, or all that were sent."""

        def enough() -> bool:
            return self._closed or len(self._ready) >= min(count, len(self._sent))

        async def wait() -> None:
            self._waiting += 1
            try:
                async with asyncio.timeout(timeout):
                    while not enough():
                        self._news.clear()
                        await self._news.wait()
            finally:
                self._waiting -= 1

        if not enough():
            with suppress(TimeoutError):
                await on_library_loop(wait())
        self._check_open()

    async def _drop_sent(self) -> None:
        """Wait for slots that are under way, and drop their results."""
        await self._wait_for_ready(len(self._sent))
        self._ready.clear()
        self._sent.clear()

    # Asking every environment.

    def render(self) -> tuple[Any, ...]:
        """Return what ``render`` of each slot's environment returns: texts in the mode ``"ansi"``."""
        return self.call("render")

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every slot's environment, or read an attribute that cannot be called.

        An environment is made where a slot has none yet. From a worker process comes a copy, by pickling.

        Args:
            name: Of the method; a wrapper's goes before the task's.
            *args: Arguments for it.
            **kwargs: Keyword arguments for it.

        Returns:
            The results, in the order of the slots.

        Raises:
            ArgumentError: It is ``reset``, ``step`` or ``close``, which this class itself has; an environment has
                nothing of this name; or a slot is under way.
            EnvFaultError: The method raised something; the environment goes on.
        """
        if name in _OWN_METHODS:
            raise ArgumentError(f"call({name!r}) would go past the vector environment; use its own {name}()")
        self._check_open()
        self._refuse_busy(self.slots)
        return tuple(self._ask(slot, None, _call, slot.index, name, args, kwargs) for slot in self.slots)

    def _ask(self, slot: Slot, target: tuple[Any, Any] | None, function: Callable[..., T], *args: Any) -> T:
        """Call a function with the environment in a slot, and return its result.

        Args:
            slot: The slot.
            target: Id and keyword arguments of the environment, which is made if it is not present; None takes the
                present one, or makes the slot's own.
            function: Called with the environment, in the process that the environment lives in.
            *args: More arguments for it.
        """
        made = slot.runner.env is not None and target is None
        failure = None if made else slot.runner.make(*(target or (slot.env_id, slot.kwargs)))
        if failure is None:
            try:
                return cast("T", slot.runner.apply(function, *args))
            except WorkerFailureError as error:
                failure = error.failure
                if failure.kind == "collateral" and target is not None:  # its worker was lost before; any other will do
                    slot.runner.close()
                    return self._ask(slot, target, function, *args)
        raise failure.error or EnvFaultError(f"{slot.name()}: {failure.message}")

    def close(self) -> None:
        """Close all environments at once, for good; later calls raise ``ClosedError``.

        Environments that do not close within some seconds are left, and a warning gives their number.
        """
        if self._closed:
            return
        self._closed = True
        if self._waiting:
            background_loop().call_soon_threadsafe(self._news.set)
        for work in self._work.copy():
            work.get_loop().call_soon_threadsafe(work.cancel)
        for slot in self.slots:
            slot.abandon_if_busy()
        here = [slot.runner for slot in self.slots if not isinstance(slot.runner.env, RemoteEnv)]
        hanging = close_all([env for runner in here for env in runner.forget()])
        left = 0 if self._pool is None else self._pool.close()
        left += wait_for_closing(0.0 if hanging or left else CLOSING_S)
        left += len(self.config.hanging)
        self.config.threads.close()
        if left:
            logger.warning("gem: environments that did not close in time, or were at work, were left: %d", left)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self.num_envs

    def __repr__(self) -> str:
        names = ", ".join(dict.fromkeys(str(env_id) for env_id in self.ids))
        return (
            f"VectorEnv({names if len(names) < 200 else names[:200] + '…'}, num_envs={self.num_envs}, seed={self.seed})"
        )

    async def begin_rollout(self) -> None:
        """Wait for pending work, and hand the slots to a rollout; afterwards ``reset`` begins anew."""
        await self._drop_sent()
        self.config.budget.note(None, "")
        for slot in self.slots:
            slot.start, slot.is_joint, slot.phase = None, False, NEW

    # Doing work.

    async def _begin(self, slots: Sequence[Slot], options: dict[str, Any] | None) -> None:
        """Begin the next episode of some slots; after a failed reset, try the plan's next, until one begins."""
        while slots:
            idle: list[Slot] = []
            starts: list[tuple[Slot, EpisodeStart]] = []
            for slot in slots:  # draws in the order of slots, whichever environment is ready first
                slot.start = start = self._queue.draw(slot.index)
                if start is None:
                    slot.take_idle()
                    idle.append(slot)
                else:
                    starts.append((slot, start))
            await self._do((slot, slot.in_place or slot.runner.env is None, slot.release) for slot in idle)
            making = [(slot, start) for slot, start in starts if not slot.fits(start)]
            outcomes = await self._do((slot, slot.makes_in_place(start), slot.make, start) for slot, start in making)
            made = [(slot, start) for slot, start in starts if outcomes.get(slot.index) is None]
            outcomes |= await self._do((slot, slot.in_place, slot.reset, start, options) for slot, start in made)
            slots = [slot for slot, start in starts if slot.take_reset(start, outcomes[slot.index])]

    async def _do(self, jobs: Iterable[tuple[Any, ...]]) -> dict[int, Any]:
        """Do jobs ``(slot, runs in place, coroutine function, *arguments)``; return results and errors by slot."""
        outcomes: dict[int, Any] = {}
        elsewhere = []
        for slot, in_place, work, *args in jobs:
            if in_place:
                outcomes[slot.index] = await work(*args)
            else:
                elsewhere.append((slot, work, *args))
        if elsewhere:
            results = await self._side_by_side(elsewhere)
            outcomes |= {job[0].index: result for job, result in zip(elsewhere, results, strict=True)}
        return outcomes

    async def _side_by_side(self, jobs: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Do jobs ``(slot, coroutine function, *arguments)`` on the library's loop; return results and errors."""
        for slot, *_ in jobs:
            slot.busy = True
        try:
            return await on_library_loop(self._gather(jobs))
        finally:
            for slot, *_ in jobs:
                slot.busy = False

    async def _gather(self, jobs: Sequence[tuple[Any, ...]]) -> list[Any]:
        coroutines = []
        for _, work, *args in jobs:
            coroutines.append(work(*args))
        gathered = asyncio.gather(*coroutines, return_exceptions=True)
        self._work.add(gathered)
        if self._closed:  # meanwhile
            gathered.cancel()
        try:
            return await gathered
        finally:
            self._work.discard(gathered)

    def _run(self, work: Coroutine[Any, Any, T]) -> T:
        """Do the work of a method in plain code, as ``_run_async`` in a coroutine."""
        try:
            return run_without_loop(work)
        except KeyboardInterrupt:
            self.close()
            raise
        except concurrent.futures.CancelledError:
            self._check_open()
            raise

    async def _run_async(self, work: Awaitable[T]) -> T:
        try:
            return await work
        except asyncio.CancelledError:
            if cast("asyncio.Task[Any]", asyncio.current_task()).cancelling():
                self.close()
            else:
                self._check_open()
            raise

    # Arguments and results.

    def _check_open(self) -> None:
        if self._closed:
            raise ClosedError("the vector environment is closed; make another with make_vec")

    def _refuse_busy(self, slots: Iterable[Slot]) -> None:
        for slot in slots:
            if slot.busy or slot.index in self._sent:
                raise ArgumentError(f"slot {slot.index} is under way; call recv() until it has come back")

    def _checked_pairs(self, actions: Actions) -> list[tuple[Slot, Action]]:
        """Return the slots to step, each with its action, in the order given."""
        self._check_open()
        slots, sent = self.slots, self._sent
        pairs = []
        for index, action in paired(actions, len(slots)):
            slot = slots[index]
            if sent or slot.busy or slot.phase is not LIVE or slot.is_joint or type(action) is not str:
                self._check_step(slot, action)
            pairs.append((slot, action))
        return pairs

    def _check_step(self, slot: Slot, action: Action) -> None:
        """Raise if a slot cannot be stepped by an action."""
        self._refuse_busy([slot])
        if slot.phase is LIVE:
            check_action(slot.index, action, slot.result[0])
        elif slot.phase is BROKEN:
            raise ResetNeededError(f"slot {slot.index} has no environment since an error was raised; call reset()")
        elif slot.phase is NEW:
            raise ResetNeededError("the vector environment has not begun; call reset() before the first step()")
        elif slot.phase is ENDED and self.autoreset == "disabled":
            raise ResetNeededError(
                f"the episode of slot {slot.index} is over, and autoreset is disabled; "
                "call reset(options={'reset_mask': …}) before the next step(). "
                f"See {page_url('vector-environments/#when-episodes-end')}"
            )


def _results(pairs: Iterable[tuple[Slot, Any]]) -> VectorStep:
    results = []
    for slot, _ in pairs:
        if type(slot.result) is not tuple:
            raise slot.result
        results.append(slot.result)
    columns = zip(*results, strict=True) if results else [()] * 5
    observations, rewards, terminated, truncated, infos = columns
    try:
        numbers = np.array(rewards, np.float64)
    except TypeError:  # several agents act in some slot
        numbers = cast("npt.NDArray[np.float64]", list(rewards))
    return VectorStep(
        list(observations),
        numbers,
        np.array(terminated, np.bool_),
        np.array(truncated, np.bool_),
        list(infos),
    )


# Applied to an environment in its own process.


def _tasks(env: AnyEnv) -> tuple[int | None, bool]:
    task: Any = env.unwrapped
    return task.num_tasks, task.endless_tasks


def _call(env: AnyEnv, slot: int, name: str, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> Any:
    try:
        found = env.get_wrapper_attr(name)
    except AttributeError:
        raise ArgumentError(f"slot {slot}: {type(env.unwrapped).__name__} has no attribute {name!r}") from None
    try:
        return found(*args, **kwargs) if callable(found) else found
    except GemError:
        raise
    except Exception as error:
        raise EnvFaultError(f"slot {slot}: {Failure.of(error, name).message}") from error
