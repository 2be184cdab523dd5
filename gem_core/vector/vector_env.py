"""``VectorEnv``: many environments that are reset and stepped together, in any backend."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import time
from collections.abc import Callable, Collection, Coroutine, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Self, TypeVar, cast

import numpy as np
import numpy.typing as npt

from gem_core.background import background_loop, on_background_loop, run_without_loop
from gem_core.closing import CLOSING_S, close_all, wait_for_closing
from gem_core.docs import page_url
from gem_core.env.wrapper import AnyEnv
from gem_core.errors import (
    ArgumentError,
    BridgeError,
    ClosedError,
    EnvFaultError,
    ResetNeededError,
)
from gem_core.making.again import Recipe
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.types import TERMINAL_STATE, Action, Info, Observation
from gem_core.vector.actions import Actions, Received, VectorStep, checked_slot, indices_and_actions, masked_slots
from gem_core.vector.attributes import VectorAttributes
from gem_core.vector.failures import Failure, WorkerFailureError
from gem_core.vector.joint import check_joint_action, lost_step
from gem_core.vector.remote import RemoteEnv, WorkerPool
from gem_core.vector.setup import OnError, VectorSetup
from gem_core.vector.slot import ALL_IN_PLACE, FaultBudget, Slot, VectorConfig

logger = logging.getLogger("gem_core")

T = TypeVar("T")

Future = concurrent.futures.Future

Work = Generator[tuple[Future[Any], float | None], None, T]
"""The work of a method, for plain code and for coroutines: it yields futures to wait for, each with a time limit."""

NEW, LIVE, ENDED, IDLE, BROKEN = "new", "live", "ended", "idle", "broken"
"""Phases of a slot: before the first episode; in an episode; after one, before the next begins; without an episode,
since the plan is exhausted; without an environment, since an error was raised."""


@dataclass
class _State:
    """The state of a slot.

    Args:
        phase: One of the phases above.
        sent: Whether a result is due that ``recv`` has not returned.
        working: Whether its environment is at work.
        result: The five values of a step, or an exception.
        ended: The last step of an episode, while the next begins.
        failed_resets: The resets that failed since then.
    """

    phase: str = NEW
    sent: bool = False
    working: bool = False
    result: Any = None
    ended: Any = None
    failed_resets: list[dict[str, Any]] = field(default_factory=list)


class VectorEnv(VectorAttributes):
    """Many environments that are reset and stepped together, each in its own slot; ``make_vec`` makes one.

    It is not a ``gymnasium.vector.VectorEnv``: texts and infos are lists. It has the same attributes.

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
    notebooks and servers. An interrupt (Ctrl-C) inside a method closes the vector environment.

    Args:
        setup: The arguments of ``make_vec``, checked.
        in_place: Values of ``concurrency`` that run in the caller's thread.
        pool: Workers for environments that live in other processes.
        in_pool: Tells whether the environment of an id lives in the pool; by default all do if there is a pool.
        borrowed: The environment of the only slot, which the caller owns and closes.
    """

    entries: list[tuple[str | None, Mapping[str, Any]]]
    """The requested ids with their keyword arguments, each once; there may be more of them than slots."""

    def __init__(
        self,
        setup: VectorSetup,
        *,
        in_place: Collection[str] = ("inline",),
        pool: WorkerPool | None = None,
        in_pool: Callable[[str | None], bool] | None = None,
        borrowed: AnyEnv | None = None,
    ) -> None:
        self.ids, self.entries = list(setup.ids), list(setup.entries)
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
        owned = zip(self.ids, setup.slot_kwargs, strict=True)
        self.slots = [Slot(index, *own, self.config, borrowed) for index, own in enumerate(owned)]
        """The slots, for ``rollout``."""
        self._states = [_State() for _ in self.slots]
        self._ready: list[int] = []
        """Slots with a result that ``recv`` has not returned, in order of completion."""
        self._in_flight: set[Future[Any]] = set()
        """Work on the library's own event loop."""
        self._news: Future[None] = Future()
        """Ends when ``recv`` has something new to look at."""

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

        setup = VectorSetup([own_id], [{}], [(own_id, {})], seed=seed, on_error=on_error, factory=factory)
        in_place = ALL_IN_PLACE if plain else ("inline",)
        return cls(setup, in_place=in_place, borrowed=env if keep_open else None)

    # Properties.

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
        return sum(state.sent for state in self._states)

    def start_of(self, slot: int) -> EpisodeStart | None:
        """Return the start of a slot's present episode; None when the slot is idle."""
        return self.slots[slot].start

    def describe(self, slot: int) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` (over the registered ones) and ``wrappers`` of the environment in a slot."""
        slot = checked_slot(slot, self.num_envs)
        self._check_open()
        described = self.slots[slot].runner.describe()
        return {**described, "id": described["id"] or self.ids[slot] or "unknown"}

    def num_tasks(self, env_id: str | None, kwargs: Mapping[str, Any] = MappingProxyType({})) -> int | None:
        """Return the number of tasks of an environment that has a data set; None for any other.

        Call it before the first ``reset``: it may make the environment in a slot, in place of the present one.
        """
        return cast("int | None", self._tasks(env_id, kwargs)[0])

    def endless_tasks(self, env_id: str | None, kwargs: Mapping[str, Any] = MappingProxyType({})) -> bool:
        """Return whether an environment generates new tasks for every epoch, at any index; see ``num_tasks``."""
        return cast("bool", self._tasks(env_id, kwargs)[1])

    def _tasks(self, env_id: str | None, kwargs: Mapping[str, Any]) -> Any:
        self._check_open()
        slot = self.slots[self.ids.index(env_id) if env_id in self.ids else 0]
        return self._asked(slot, (env_id or slot.env_id, dict(kwargs)), _num_tasks)

    def _asked(self, slot: Slot, target: tuple[Any, Any] | None, function: Callable[..., T], *args: Any) -> T:
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
                    return self._asked(slot, target, function, *args)
        raise failure.error or EnvFaultError(f"{slot.name()}: {failure.message}")

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
            acting = ", ".join(map(repr, self._states[slot].result[0]))
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

    def _reset(self, seed: int | None, options: dict[str, Any] | None) -> Work[tuple[list[Observation], list[Info]]]:
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
            yield from self._finish_under_way()
            self._queue = self._plan
            self.config.budget.note(None, "")
        else:
            self._refuse_busy(chosen)
        for index in chosen:
            self._states[index].ended, self._states[index].failed_resets = None, []
        yield from self._begin(chosen, options)
        self._raise_first_error(chosen)
        results = [state.result for state in self._states]
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
        return self._run(self._step(self._checked_pairs(actions)))

    async def step_async(self, actions: Actions) -> VectorStep:
        """``step`` for code that runs in an event loop, without blocking it.

        If it is cancelled, as by a time limit, the slots go on, and ``recv`` returns their results.
        """
        pairs = self._checked_pairs(actions)
        return await self._run_async(self._step(pairs), [index for index, _ in pairs])

    def _step(self, pairs: list[tuple[int, Action]]) -> Work[VectorStep]:
        yield from self._advance(pairs)
        return self._results([index for index, _ in pairs])

    def _advance(self, pairs: list[tuple[int, Action]]) -> Work[None]:
        """Step slots, then begin the next episodes of slots whose episode ended."""
        slots, states = self.slots, self._states
        due: list[int] = []
        elsewhere: list[tuple[int, Action]] = []
        for index, action in pairs:
            if states[index].phase is not LIVE:
                if not self._is_idle(index):
                    due.append(index)  # next_step: this call begins the next episode, and the action is ignored
            elif slots[index].in_place:
                outcome = slots[index].runner.step(action)
                if type(outcome) is tuple and not (outcome[2] or outcome[3]):
                    states[index].result = outcome
                elif self._take(index, outcome):
                    due.append(index)
            else:
                elsewhere.append((index, action))
        if elsewhere:
            outcomes = yield from self._all([(index, False, slots[index].step(action)) for index, action in elsewhere])
            due += [index for index, _ in elsewhere if self._take(index, outcomes[index])]
        if due:
            yield from self._begin(sorted(due), None)

    # Methods that do not wait for all slots.

    def send(self, actions: Actions) -> None:
        """Begin to step all slots, or the slots that a mapping names; ``recv`` returns the results.

        Raises:
            ArgumentError: The number of actions is not the number of slots, or a slot does not exist or is under way.
            ResetNeededError: A slot has no episode, and none begins by itself.
        """
        self._check_open()
        for pair in self._checked_pairs(actions):
            self._states[pair[0]].sent = True
            self._go_on([pair[0]], self._advance([pair]))

    def reset_slot(self, slot: int) -> None:
        """Begin the next episode of a slot, also in the middle of one; ``recv`` returns its first observation.

        The reward is then 0, and the flags are false.
        """
        slot = checked_slot(slot, self.num_envs)
        self._check_open()
        self._refuse_busy([slot])
        state = self._states[slot]
        state.ended, state.failed_resets, state.sent = None, [], True
        self._go_on([slot], self._begin([slot], None))

    def abort_slot(self, slot: int, error: dict[str, Any] | None, cause: BaseException | None = None) -> None:
        """``reset_slot`` in the middle of an episode.

        Args:
            slot: Number of the slot.
            error: A failure outside the environment, in the form of ``info["error"]``, counted as a fault; None if
                nothing failed, as when the history is longer than the model's context.
            cause: The exception, if there was one.
        """
        self.slots[slot].note_end(error, cause)
        self.reset_slot(slot)

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
        return await self._run_async(self._recv(min_envs, timeout))

    def _recv(self, min_envs: int, timeout: float | None) -> Work[Received]:
        if type(min_envs) is not int or min_envs < 0:
            raise ArgumentError(f"min_envs must be a whole number from 0 up, not {min_envs!r}")
        if not self.under_way:
            raise ArgumentError("nothing is under way: recv() returns the results of send()")
        deadline = None if timeout is None else time.monotonic() + timeout
        while len(self._ready) < min(min_envs, self.under_way):
            news = self._news
            left = None if deadline is None else deadline - time.monotonic()
            if left is not None and left <= 0:
                break
            if len(self._ready) < min(min_envs, self.under_way):  # nothing has come since news was taken
                yield news, left
        # A failure is raised only after all other results have been received, so that none of them is lost.
        ready = list(self._ready)
        order = [index for index in ready if isinstance(self._states[index].result, tuple)] or ready[:1]
        for index in order:
            self._ready.remove(index)
            self._states[index].sent = False
        return Received(order, *self._results(order))

    def close(self) -> None:
        """Close all environments at once, for good; later calls raise ``ClosedError``.

        Environments that do not close within some seconds are left, and a warning gives their number.
        """
        if self._closed:
            return
        self._closed = True
        self._tell_news()
        for future in list(self._in_flight):
            future.cancel()
        for slot in self.slots:
            slot.abandon_if_busy()
        here = [slot.runner for slot in self.slots if not isinstance(slot.runner.env, RemoteEnv)]
        hanging = close_all([env for runner in here for env in runner.forget()])
        left = 0 if self._pool is None else self._pool.close()
        left += wait_for_closing(0.0 if hanging or left else CLOSING_S)
        busy = [runner for runner in self.config.busy.copy() if not isinstance(runner.env, RemoteEnv)]
        left += sum(runner.abandoned for runner in busy)
        self.config.pool.close()
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

    # For rollout.

    async def begin_rollout(self) -> None:
        """Wait for pending work, and hand the slots to a rollout; afterwards ``reset`` begins anew."""
        await self._run_async(self._finish_under_way())
        self.config.budget.note(None, "")
        for slot, state in zip(self.slots, self._states, strict=True):
            slot.start, slot.is_joint, state.phase = None, False, NEW

    # The next episodes.

    def _begin(self, indices: Sequence[int], options: dict[str, Any] | None) -> Work[None]:
        """Begin the next episode of some slots; after a failed reset, try the plan's next, until one begins."""
        while indices:
            starts: list[tuple[int, EpisodeStart]] = []
            for index in indices:  # draws in the order of slots, whichever environment is ready first
                start = self.slots[index].start = self._queue.draw(index)
                if start is not None:
                    starts.append((index, start))
                else:
                    yield from self._make_idle(index)
            making = [(index, start) for index, start in starts if not self.slots[index].fits(start)]
            outcomes: dict[int, Any] = yield from self._all(
                [
                    (index, self.slots[index].prepares_in_place(start), self.slots[index].prepare(start))
                    for index, start in making
                ]
            )
            outcomes |= yield from self._all(
                [
                    (index, self.slots[index].in_place, self.slots[index].reset(start, options))
                    for index, start in starts
                    if outcomes.get(index) is None
                ]
            )
            indices = [index for index, start in starts if self._take_reset(index, start, outcomes[index])]

    def _make_idle(self, index: int) -> Work[None]:
        slot, state = self.slots[index], self._states[index]
        slot.is_joint, state.phase = False, IDLE
        self._set_first_result(index, TERMINAL_STATE, {"idle": True})
        yield from self._all([(index, slot.in_place or slot.runner.env is None, slot.release())])

    def _take_reset(self, index: int, start: EpisodeStart, outcome: Any) -> bool:
        """Store the outcome of a reset; tell whether the next episode of the plan must be tried."""
        state = self._states[index]
        if isinstance(outcome, Failure):
            try:
                error = self.slots[index].fault(outcome)
                state.failed_resets.append(_failed_reset(self.slots[index], start, error))
                self.slots[index].note_end(error)
            except Exception as raised:  # noqa: BLE001 - raised again when the result is returned
                state.phase, state.result = BROKEN, raised
                return False
            return True
        if isinstance(outcome, BaseException):
            state.phase, state.result = BROKEN, outcome
            return False
        state.phase = LIVE
        self._set_first_result(index, *outcome)
        return False

    def _set_first_result(self, index: int, observation: Observation, info: Info) -> None:
        state = self._states[index]
        if state.failed_resets:
            info["failed_resets"], state.failed_resets = state.failed_resets, []
        ended, state.ended = state.ended, None
        if ended is None:
            state.result = (observation, {} if isinstance(observation, dict) else 0.0, False, False, info)
        else:
            info["final_obs"], info["final_info"] = ended[0], ended[4]
            state.result = observation, ended[1], ended[2], ended[3], info

    def _take(self, index: int, outcome: Any) -> bool:
        """Store the outcome of a step; tell whether the next episode begins now."""
        state, config = self._states[index], self.config
        try:
            if isinstance(outcome, BaseException):
                raise outcome
            if isinstance(outcome, Failure):
                error = self.slots[index].fault(outcome)
                outcome = lost_step(error, joint=self.slots[index].is_joint)
            elif not (outcome[2] or outcome[3]):
                state.result = outcome
                return False
            self.slots[index].note_end(outcome[4].get("error"))
        except Exception as raised:  # noqa: BLE001 - raised again when the result is returned
            state.phase, state.result = BROKEN, raised
            return False
        state.phase, state.result = ENDED, outcome
        if config.autoreset != "same_step":
            return False
        # The environment may reuse its info dictionary in reset.
        state.ended = (*outcome[:4], outcome[4].copy())
        return True

    def _is_idle(self, index: int) -> bool:
        """Tell whether a slot is idle, and store its result if so; raise if the slot cannot be stepped."""
        state = self._states[index]
        if state.phase is IDLE:
            state.result = (TERMINAL_STATE, 0.0, False, False, {"idle": True})
            return True
        if state.phase is BROKEN:
            raise ResetNeededError(f"slot {index} has no environment since an error was raised; call reset()")
        if state.phase is NEW:
            raise ResetNeededError("the vector environment has not begun; call reset() before the first step()")
        if self.config.autoreset == "disabled":
            raise ResetNeededError(
                f"the episode of slot {index} is over, and autoreset is disabled; "
                "call reset(options={'reset_mask': …}) before the next step(). "
                f"See {page_url('vector-environments/#when-episodes-end')}"
            )
        return False

    # Doing work: in place at once, the rest on the library's own event loop, side by side.

    def _all(self, jobs: list[tuple[int, bool, Coroutine[Any, Any, Any]]]) -> Work[dict[int, Any]]:
        """Do jobs, each ``(slot, runs in place, coroutine)``; return results and exceptions by slot."""
        outcomes: dict[int, Any] = {}
        for index, in_place, job in jobs:
            if in_place:
                try:
                    outcomes[index] = run_without_loop(job)
                except Exception as error:  # noqa: BLE001 - raised again when the result is returned
                    outcomes[index] = error
        elsewhere = [(index, job) for index, in_place, job in jobs if not in_place]
        if elsewhere:
            for index, _ in elsewhere:
                self._states[index].working = True
            future = asyncio.run_coroutine_threadsafe(_gather([job for _, job in elsewhere]), background_loop())
            self._in_flight.add(future)
            future.add_done_callback(self._in_flight.discard)
            yield future, None
            for (index, _), outcome in zip(elsewhere, future.result(), strict=True):
                self._states[index].working = False
                outcomes[index] = outcome
        return outcomes

    def _run(self, work: Work[T]) -> T:
        """Do the work of a method in plain code."""
        self._check_open()
        try:
            while True:
                future, seconds = next(work)
                if on_background_loop() and not future.done():
                    raise BridgeError(
                        "a plain method of a vector environment was called on the library's own event loop, and would "
                        "wait for itself; await step_async, reset_async or recv_async there instead"
                    )
                concurrent.futures.wait([future], seconds)
                self._check_open()
        except StopIteration as finished:
            return cast("T", finished.value)
        except KeyboardInterrupt:
            self.close()
            raise

    async def _run_async(self, work: Work[T], indices: Sequence[int] = ()) -> T:
        """Do the work of a method in a coroutine; if it is cancelled, ``recv`` returns the results of the slots."""
        self._check_open()
        while True:
            try:
                future, seconds = next(work)
            except StopIteration as finished:
                return cast("T", finished.value)
            try:
                await wait_for_future(future, seconds)
            except asyncio.CancelledError:
                for index in indices:
                    self._states[index].sent = True
                future.add_done_callback(lambda _: self._go_on(indices, work))
                raise
            self._check_open()

    def _go_on(self, indices: Sequence[int], work: Work[Any]) -> None:
        """Do work until it has to wait, and the rest in callbacks; afterwards ``recv`` has the results."""
        try:
            future, _ = next(work)
        except StopIteration:
            pass
        except concurrent.futures.CancelledError:
            return  # the vector environment was closed
        except Exception as error:  # noqa: BLE001 - raised again when the result is returned
            for index in indices:
                self._states[index].result = error
        else:
            future.add_done_callback(lambda _: self._go_on(indices, work))
            return
        self._ready += indices
        self._tell_news()

    def _tell_news(self) -> None:
        news, self._news = self._news, Future()
        news.set_result(None)

    def _finish_under_way(self) -> Work[None]:
        """Wait for slots that are under way, and drop their results."""
        while self._in_flight:
            yield next(iter(self._in_flight)), None
        self._ready.clear()
        for state in self._states:
            state.sent = False

    # Arguments and results.

    def _check_open(self) -> None:
        if self._closed:
            raise ClosedError("the vector environment is closed; make another with make_vec")

    def _refuse_busy(self, indices: Iterable[int]) -> None:
        for index in indices:
            if self._states[index].sent or self._states[index].working:
                raise ArgumentError(f"slot {index} is under way; call recv() until it has come back")

    def _checked_pairs(self, actions: Actions) -> list[tuple[int, Action]]:
        self._check_open()
        pairs = indices_and_actions(actions, self.num_envs)
        for index, action in pairs:
            state = self._states[index]
            if state.phase is LIVE:
                if state.sent or state.working:
                    self._refuse_busy([index])
                if self.slots[index].is_joint or type(action) is not str:
                    check_joint_action(index, action, state.result[0])
            else:
                self._refuse_busy([index])
                self._is_idle(index)
        return pairs

    def _results(self, order: Sequence[int]) -> VectorStep:
        results = [self._states[index].result for index in order]
        if not results:
            empty = np.zeros(0)
            return VectorStep([], empty, empty.astype(bool), empty.astype(bool), [])
        self._raise_first_error(order)
        observations, rewards, terminated, truncated, infos = zip(*results, strict=True)
        return VectorStep(
            list(observations),
            _rewards(rewards),
            np.array(terminated, np.bool_),
            np.array(truncated, np.bool_),
            list(map(dict.copy, infos)),  # some environments reuse their info dictionary
        )

    def _raise_first_error(self, order: Iterable[int]) -> None:
        for index in order:
            if isinstance(self._states[index].result, BaseException):
                raise self._states[index].result


async def _gather(jobs: list[Coroutine[Any, Any, T]]) -> list[T | BaseException]:
    return await asyncio.gather(*jobs, return_exceptions=True)


async def wait_for_future(future: Future[Any], seconds: float | None) -> None:
    """Wait for a future of another thread, which goes on if the waiter is cancelled."""
    loop, done = asyncio.get_running_loop(), asyncio.Event()

    def tell(_: object) -> None:
        with suppress(RuntimeError):  # the loop was closed
            loop.call_soon_threadsafe(done.set)

    future.add_done_callback(tell)
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await done.wait()


def _num_tasks(env: AnyEnv) -> tuple[int | None, bool]:
    task: Any = env.unwrapped
    return task.num_tasks, task.endless_tasks


def _failed_reset(slot: Slot, start: EpisodeStart, error: dict[str, Any]) -> dict[str, Any]:
    """Return the entry of ``info["failed_resets"]`` for one reset that failed."""
    env_id, kwargs = slot.target(start)
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


def _rewards(rewards: tuple[Any, ...]) -> npt.NDArray[np.float64]:
    try:
        return np.fromiter(rewards, np.float64, len(rewards))
    except TypeError:  # several agents act in some slot
        return cast("npt.NDArray[np.float64]", list(rewards))
