"""``VectorEnv``: many environments that are reset and stepped together, in any backend."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, Self, cast

import numpy as np
import numpy.typing as npt

from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, BridgeError, ClosedError, EnvFaultError, NotSupportedError
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.types import Action, Info, Observation
from gem_core.vector.actions import Actions, Received, VectorStep, checked_slot, indices_and_actions, masked_slots
from gem_core.vector.attributes import VectorAttributes
from gem_core.vector.call import InterruptibleCall
from gem_core.vector.commands import Failure
from gem_core.vector.executor import Executor
from gem_core.vector.joint import check_joint_action
from gem_core.vector.local import LocalExecutor, SyncExecutor
from gem_core.vector.scheduler import Batch, First, Scheduler, StepBatch
from gem_core.vector.setup import VectorSetup
from gem_core.vector.slot import LIVE, OnError, Slot
from gem_core.vector.waiting import Condition, Signal


class VectorEnv(VectorAttributes):
    """Many environments that are reset and stepped together, each in its own slot; ``make_vec`` makes one.

    It is not a ``gymnasium.vector.VectorEnv``: texts and infos are lists. It has the same attributes.

    When an episode ends, the next begins in the same call (autoreset ``same_step``): the observation is the first of
    the new episode, and ``info["final_obs"]`` and ``info["final_info"]`` hold the last of the old one. If an
    environment fails, its episode ends as truncated, with ``info["final_info"]["error"]``, and the environment is
    replaced. When a plan is exhausted, a slot is idle: its observation is ``TERMINAL_STATE``, its flags are false,
    ``info["idle"]`` is true, and its actions are ignored.

    Where several agents act in a slot, its observation, reward and action are dictionaries by agent, and its flags are
    of the whole episode; ``info["agents"]`` holds each agent's info, ``info["terminations"]`` and
    ``info["truncations"]`` each agent's flags.

    ``step`` waits for all slots that it stepped; ``send`` does not wait, and ``recv`` returns results as they come.
    Each method that waits has an ``_async`` form, which does not block the event loop; all work in plain code,
    notebooks and servers.

    Args:
        setup: Arguments that it is made from; see ``make_vec``.
        executors: Executors in which environments live.
        executor_of: Returns the number of the executor for an id, if there are several.
    """

    entries: list[tuple[str | None, Mapping[str, Any]]]
    """The requested ids with their keyword arguments, each once; there may be more of them than slots."""

    def __init__(
        self, setup: VectorSetup, *executors: Executor, executor_of: Callable[[str | None], int] | None = None
    ) -> None:
        self.ids, self.entries = list(setup.ids), list(setup.entries)
        rules = setup.rules()
        self._own_source = rules.source
        self._closed = False
        self._scheduler = Scheduler(self.ids, setup.slot_kwargs, rules, executors, executor_of)

    @classmethod
    def around(
        cls,
        env: AnyEnv,
        *,
        seed: int | None = None,
        on_error: OnError = "truncate",
        keep_open: bool = False,
        plain: bool = True,
    ) -> VectorEnv:
        """Return a vector environment of one slot that uses a given environment.

        If the environment fails, its ``spawn`` makes the replacement.

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
            return cast("AnyEnv", env.get_wrapper_attr("spawn")(**overrides))

        setup = VectorSetup([own_id], [{}], [(own_id, {})], seed=seed, on_error=on_error, factory=factory)
        executor = SyncExecutor(setup) if plain else LocalExecutor(setup)
        executor.runners[0].borrowed = env if keep_open else None
        return cls(setup, executor)

    @property
    def _slots(self) -> list[Slot]:
        return self._scheduler.slots

    # Properties.

    @property
    def signal(self) -> Signal:
        """Signal that is set when there is a result for ``recv``; set it to make ``wait`` check ``other`` again."""
        return self._scheduler.signal

    @property
    def seed(self) -> int:
        """Seed of the run, from which the seed of each episode is derived."""
        return self._scheduler.rules.source.seed

    @property
    def faults(self) -> int:
        """Number of environments that failed so far."""
        return self._scheduler.rules.budget.total

    @property
    def on_error(self) -> OnError:
        """Whether an environment that fails ends its episode, or the run; see ``make_vec``."""
        return self._scheduler.rules.on_error

    @property
    def own_source(self) -> EpisodeQueue:
        """Queue of its own episodes, from the plan and seed that it was made with; see ``rollout``."""
        return self._own_source

    def start_of(self, slot: int) -> EpisodeStart | None:
        """Return what the present episode of a slot started from; None when it is idle."""
        return self._slots[slot].episode

    def describe(self, slot: int) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` (over the registered ones) and ``wrappers`` of the environment in a slot."""
        slot = checked_slot(slot, self.num_envs)
        with self._call():
            described = self._scheduler.at[slot].describe(slot)
        if described["id"] is None:
            described["id"] = self.ids[slot] or "unknown"
        return described

    def num_tasks(self, env_id: str | None, kwargs: Mapping[str, Any] = MappingProxyType({})) -> int | None:
        """Return the number of tasks of an environment that has a data set; None for any other.

        Call it before the first ``reset``: the environment may be made in a slot, and replace the one that is there.
        """
        return self._tasks(env_id, kwargs)[0]

    def endless_tasks(self, env_id: str | None, kwargs: Mapping[str, Any] = MappingProxyType({})) -> bool:
        """Return whether an environment generates new tasks for every epoch, at any index; see ``num_tasks``."""
        return self._tasks(env_id, kwargs)[1]

    def _tasks(self, env_id: str | None, kwargs: Mapping[str, Any]) -> tuple[int | None, bool]:
        slot = self.ids.index(env_id) if env_id in self.ids else 0
        wanted = env_id or self.ids[slot]
        with self._call():
            return self._scheduler.place(slot, wanted).tasks(slot, wanted, dict(kwargs))

    def sample_random_action(self, slot: int, agent: str | None = None) -> str:
        """Return a valid action for the present state of a slot; an empty one where there is no environment yet.

        Args:
            slot: Number of the slot.
            agent: Whose action, where several agents act.

        Raises:
            ArgumentError: There is no such slot, or several agents act there and none of them is named.
            SamplingNotSupported: The environment cannot sample actions.
            EnvFaultError: The environment failed.
        """
        slot = checked_slot(slot, self.num_envs)
        current = self._slots[slot]
        if current.is_joint and agent is None:
            acting = ", ".join(map(repr, current.result[0]))
            raise ArgumentError(f"several agents act in slot {slot}: name one of {acting}")
        seed = None if current.episode is None else current.episode.action_seed
        try:
            with self._call():
                return self._scheduler.at[slot].sample_random_action(slot, seed, agent)
        except (NotSupportedError, BridgeError, ClosedError):
            raise
        except Exception as error:
            what = error if isinstance(error, EnvFaultError) else Failure.of(error, "sample_random_action").message
            raise EnvFaultError(f"{current.name()}: {what}") from error

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
        with self._call() as call:
            batch, options = self._batch_and_options(seed, options)
            if len(batch.order) == self.num_envs:
                call.wait(self._scheduler.is_idle, Batch())
            self._begin(batch, options)
            call.wait(batch.is_over, batch)
            return self._reset_results(batch.order)

    async def reset_async(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[list[Observation], list[Info]]:
        """``reset`` for code that runs in an event loop, without blocking it."""
        with self._call() as call:
            batch, options = self._batch_and_options(seed, options)
            if len(batch.order) == self.num_envs:
                await call.wait_async(self._scheduler.is_idle, Batch())
            self._begin(batch, options)
            await call.wait_async(batch.is_over, batch)
            return self._reset_results(batch.order)

    def step(self, actions: Actions) -> VectorStep:
        """Step all slots, or those that a mapping names, and wait for them.

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
        with self._call() as call:
            batch = self._start_step(actions)
            if batch.waiting:
                call.wait(batch.is_over, batch)
            return self._results(batch.order)

    async def step_async(self, actions: Actions) -> VectorStep:
        """``step`` for code that runs in an event loop, without blocking it.

        If it is cancelled, as by a time limit, the slots go on, and ``recv`` returns their results.
        """
        with self._call() as call:
            batch = self._start_step(actions)
            await call.wait_async(batch.is_over, batch)
            return self._results(batch.order)

    # Methods that do not wait for all slots.

    def send(self, actions: Actions) -> None:
        """Begin to step all slots, or those that a mapping names; ``recv`` returns the results.

        Raises:
            ArgumentError: The number of actions is not the number of slots, or a slot does not exist or is under way.
            ResetNeededError: A slot has no episode, and none begins by itself.
        """
        with self._call():
            self._scheduler.step(self._checked_pairs(actions), self._scheduler.sent)

    def send_reset(self, source: EpisodeQueue | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin an episode in every slot; ``recv`` returns their observations, with reward 0 and flags false."""
        with self._call() as call:
            call.wait(self._scheduler.is_idle, Batch())
            self._scheduler.begin_run(source or self._own_source)
            self._scheduler.begin(range(self.num_envs), options, self._scheduler.sent)

    def begin_next(self, slot: int) -> None:
        """Begin the next episode of a slot; ``recv`` returns its first observation, with reward 0 and flags false."""
        self._begin_one(slot, self._slots[slot].begin)

    def give_up(self, slot: int, error: dict[str, Any] | None, cause: BaseException | None = None) -> None:
        """``begin_next`` in the middle of an episode.

        Args:
            slot: Number of the slot.
            error: What failed outside the environment, in the form of ``info["error"]``, counted as a fault; None if
                nothing failed, as when the history is longer than the model's context.
            cause: The exception, if there was one.
        """
        self._begin_one(slot, partial(self._slots[slot].give_up, error, cause))

    def _begin_one(self, slot: int, first: First) -> None:
        with self._call():
            self._scheduler.refuse_busy([slot])
            self._scheduler.run([(slot, first)], self._scheduler.sent)

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
        with self._call() as call:
            enough, deadline = self._condition_and_deadline(min_envs, timeout)
            call.wait(enough, self._scheduler.sent, deadline)
            return self._received()

    async def recv_async(self, min_envs: int = 1, timeout: float | None = None) -> Received:
        """``recv`` for code that runs in an event loop, without blocking it."""
        with self._call() as call:
            enough, deadline = self._condition_and_deadline(min_envs, timeout)
            await call.wait_async(enough, self._scheduler.sent, deadline)
            return self._received()

    def wait(self, other: Condition = lambda: False) -> None:
        """Wait until ``recv`` has a result, or ``other`` returns True; see ``signal``."""
        sent = self._scheduler.sent
        with self._call() as call:
            call.wait(lambda: bool(sent.done) or other(), sent)

    async def wait_async(self, other: Condition = lambda: False) -> None:
        """``wait`` for code that runs in an event loop, without blocking it."""
        sent = self._scheduler.sent
        with self._call() as call:
            await call.wait_async(lambda: bool(sent.done) or other(), sent)

    async def drain_async(self) -> None:
        """Wait for slots under way and drop their results, without blocking the event loop."""
        with self._call() as call:
            await call.wait_async(self._scheduler.is_idle, Batch())
            self._scheduler.drop_results()

    @property
    def under_way(self) -> int:
        """Number of slots that were sent an action or a reset and have not been received."""
        return len(self._scheduler.sent.waiting) + len(self._scheduler.sent.done)

    def close(self) -> None:
        """Close every environment for good; later calls raise ``ClosedError``."""
        self._closed = True
        with InterruptibleCall(self._scheduler, self._replace_scheduler):
            self._scheduler.close()

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

    def _batch_and_options(
        self, seed: int | None, options: dict[str, Any] | None
    ) -> tuple[StepBatch, dict[str, Any] | None]:
        if options is not None and not isinstance(options, Mapping):
            raise ArgumentError(f"options must be a mapping of names to values, not {options!r:.200}")
        chosen = list(range(self.num_envs))
        if options and "reset_mask" in options:
            options = dict(options)
            chosen = masked_slots(options.pop("reset_mask"), self.num_envs)
        if seed is not None:
            if len(chosen) < self.num_envs:
                raise ArgumentError(
                    "a seed starts the whole run over, so it cannot go with a reset_mask for some slots"
                )
            self._own_source = self._own_source.restarted(seed)
        return StepBatch(chosen), options or None

    def _begin(self, batch: StepBatch, options: dict[str, Any] | None) -> None:
        if len(batch.order) < self.num_envs:
            self._scheduler.refuse_busy(batch.order)
        else:
            self._scheduler.begin_run(self._own_source)
        self._scheduler.begin(batch.order, options, batch)

    def _start_step(self, actions: Actions) -> StepBatch:
        pairs = self._checked_pairs(actions)
        batch = StepBatch([index for index, _ in pairs])
        self._scheduler.step(pairs, batch)
        return batch

    def _checked_pairs(self, actions: Actions) -> list[tuple[int, Action]]:
        pairs = indices_and_actions(actions, self.num_envs)
        self._scheduler.refuse_busy(index for index, _ in pairs)
        slots = self._slots
        for index, action in pairs:
            slot = slots[index]
            if slot.phase is not LIVE:
                slot.check_steppable()
            elif slot.is_joint or not isinstance(action, str):
                check_joint_action(index, action, slot.result[0])
        return pairs

    def _condition_and_deadline(self, min_envs: int, timeout: float | None) -> tuple[Condition, float | None]:
        sent = self._scheduler.sent
        if not self.under_way:
            raise ArgumentError("nothing is under way; call send() before recv()")
        if type(min_envs) is not int or min_envs < 0:
            raise ArgumentError(f"min_envs must be a whole number from 0 up, not {min_envs!r}")
        wanted = min(min_envs, self.under_way)
        return lambda: len(sent.done) >= wanted, None if timeout is None else time.monotonic() + timeout

    def _call(self) -> InterruptibleCall:
        if self._closed:
            raise ClosedError("the vector environment is closed; make another with make_vec")
        return InterruptibleCall(self._scheduler, self._replace_scheduler)

    def _replace_scheduler(self) -> None:
        """Replace the scheduler after an interrupt has left it in an inconsistent state."""
        old = self._scheduler
        self._scheduler = old.renewed()
        if self._own_source is old.rules.source:
            self._own_source = self._scheduler.rules.source
        # In a thread, since the old scheduler may hold its own locks for ever.
        threading.Thread(target=old.close, name="gem-close", daemon=True).start()

    def _received(self) -> Received:
        order = self._scheduler.collect()
        return Received(order, *self._results(order))

    def _results(self, order: Sequence[int]) -> VectorStep:
        slots = self._slots
        results = [slots[index].result for index in order]
        if not results:
            empty = np.zeros(0)
            return VectorStep([], empty, empty.astype(bool), empty.astype(bool), [])
        if error := next((result for result in results if not isinstance(result, tuple)), None):
            raise error
        observations, rewards, terminated, truncated, infos = zip(*results, strict=True)
        # One byte for each flag, read as bools: a third of the time of np.array.
        return VectorStep(
            list(observations),
            _rewards(rewards),
            np.frombuffer(bytearray(terminated), np.bool_),
            np.frombuffer(bytearray(truncated), np.bool_),
            list(map(dict.copy, infos)),  # some environments reuse their info dictionary
        )

    def _reset_results(self, chosen: list[int]) -> tuple[list[Observation], list[Info]]:
        self._results(chosen)
        began = set(chosen)
        observations = [slot.result[0] if isinstance(slot.result, tuple) else "" for slot in self._slots]
        infos = [slot.result[4] if slot.index in began else {} for slot in self._slots]
        return observations, infos


def _rewards(rewards: tuple[Any, ...]) -> npt.NDArray[np.float64]:
    try:
        return np.fromiter(rewards, np.float64, len(rewards))
    except TypeError:  # several agents act in some slot
        return cast("npt.NDArray[np.float64]", list(rewards))
