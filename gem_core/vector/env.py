"""``VectorEnv``: many environments that are reset and stepped together, wherever they live."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, Self, cast

import numpy as np

from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, BridgeError, ClosedError, EnvFaultError, NotSupportedError
from gem_core.records.plans import EpisodeQueue, EpisodeStart
from gem_core.registry.lookup import registry
from gem_core.types import Info, Observation
from gem_core.vector.actions import Actions, Received, VectorStep, checked_slot, indices_and_actions, masked_slots
from gem_core.vector.call import Call
from gem_core.vector.commands import Failure
from gem_core.vector.engine import Batch, Engine, Start
from gem_core.vector.host import Host
from gem_core.vector.setup import VectorSetup
from gem_core.vector.signal import Signal
from gem_core.vector.slot import LIVE, Autoreset, OnError, Rules, Slot


class VectorEnv:
    """Many environments that are reset and stepped together, each in a slot of its own; ``make_vec`` makes one.

    It is not a ``gymnasium.vector.VectorEnv``: texts and infos come as lists.

    An episode that ends is followed by the next in the same call (autoreset ``same_step``): the observation is the new
    episode's first, and ``info["final_obs"]`` and ``info["final_info"]`` hold the last of the old. An environment that
    fails ends its episode as truncated, with ``info["final_info"]["error"]``, and is replaced. When a plan is exhausted
    a slot is idle: ``TERMINAL_STATE``, flags false, ``info["idle"]``, and its actions are ignored.

    ``step`` waits for all that it stepped; ``send`` and ``recv`` wait for nobody. Both have a form to await, which
    blocks no event loop, and all work from plain code, in notebooks and in servers.

    Args:
        setup: What it is made from; see ``make_vec``.
        hosts: Where environments live: one place, or several with a function that tells which of them an id lives on.
        rules: What all slots share; by default as ``setup`` says.
    """

    ids: list[str | None]
    """The id of each slot's own environment."""

    entries: list[tuple[str | None, Mapping[str, Any]]]
    """The ids that were asked for, with their keyword arguments, each once; there may be more of them than slots."""

    def __init__(
        self,
        setup: VectorSetup,
        *hosts: Host,
        host_of: Callable[[str | None], int] | None = None,
        rules: Rules | None = None,
    ) -> None:
        self.ids, self.entries = list(setup.ids), list(setup.entries)
        rules = rules or setup.rules()
        if any(host.replays for host in hosts):
            rules.replayable = lambda env_id: env_id is not None and registry().env(env_id).deterministic
        self._own_source = rules.source
        self._closed = False
        self._engine = Engine(self.ids, setup.slot_kwargs, rules, hosts, host_of)

    @classmethod
    def around(
        cls, env: AnyEnv, *, seed: int | None = None, on_error: str = "truncate", keep_open: bool = False
    ) -> VectorEnv:
        """Return a vector environment of one slot, which begins with a given environment and does not make its own.

        A replacement, when it is needed, is the environment's own ``spawn``.

        Args:
            env: What the slot begins with.
            seed: Seed of the run; None draws one.
            on_error: ``"truncate"`` or ``"raise"``.
            keep_open: Leave closing ``env`` to the caller; replacements are closed in any case.
        """
        from gem_core.vector.backends import around

        return around(env, seed=seed, on_error=on_error, keep_open=keep_open)

    @property
    def _rules(self) -> Rules:
        return self._engine.rules

    @property
    def _slots(self) -> list[Slot]:
        return self._engine.slots

    # What it is.

    @property
    def signal(self) -> Signal:
        """What is set when there may be something for ``recv``, and by whoever else wants to wake ``wait``."""
        return self._engine.signal

    @property
    def num_envs(self) -> int:
        """Number of slots."""
        return len(self.ids)

    @property
    def seed(self) -> int:
        """Seed of the run, from which each episode's own is made."""
        return self._rules.source.seed

    @property
    def faults(self) -> int:
        """Number of environments that failed so far."""
        return self._rules.budget.total

    @property
    def autoreset(self) -> Autoreset:
        """When the next episode begins; see ``make_vec``."""
        return self._rules.autoreset

    @property
    def on_error(self) -> OnError:
        """Whether an environment that fails ends its episode, or the run; see ``make_vec``."""
        return self._rules.on_error

    @property
    def own_source(self) -> EpisodeQueue:
        """What its own episodes start from, by the plan and seed that it was made with; see ``rollout``."""
        return self._own_source

    def start_of(self, slot: int) -> EpisodeStart | None:
        """Return what the present episode of a slot started from; None when it is idle."""
        return self._slots[slot].draw

    def describe(self, slot: int) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` (over the registered ones) and ``wrappers`` of the environment in a slot."""
        slot = checked_slot(slot, self.num_envs)
        with self._call():
            described: dict[str, Any] = self._engine.at[slot].ask(slot, "describe")
        if described["id"] is None:
            described["id"] = self.ids[slot] or "unknown"
        return described

    def num_tasks(self, env_id: str | None, kwargs: Mapping[str, Any] = MappingProxyType({})) -> int | None:
        """Return the number of tasks of an environment that has a data set; None for any other.

        Ask before the first ``reset``: the environment may be made in a slot, in the place of the one that is there.
        """
        return cast("int | None", self._asked_of("num_tasks", env_id, kwargs))

    def endless_tasks(self, env_id: str | None, kwargs: Mapping[str, Any] = MappingProxyType({})) -> bool:
        """Return whether an environment makes fresh tasks for every epoch, and takes any index; see ``num_tasks``."""
        return bool(self._asked_of("endless_tasks", env_id, kwargs))

    def _asked_of(self, question: str, env_id: str | None, kwargs: Mapping[str, Any]) -> Any:
        slot = self.ids.index(env_id) if env_id in self.ids else 0
        wanted = env_id or self.ids[slot]
        engine = self._engine
        with self._call():
            host = engine.at[slot] if engine.host_of is None else engine.hosts[engine.host_of(wanted)]
            engine.at[slot] = host
            return host.ask(slot, question, wanted, dict(kwargs))

    def sample_random_action(self, slot: int) -> str:
        """Return a valid action for the present state of a slot; an empty one where there is no environment yet.

        Raises:
            ArgumentError: There is no such slot.
            SamplingNotSupported: The environment does not say what is valid.
            EnvFaultError: It failed.
        """
        slot = checked_slot(slot, self.num_envs)
        current = self._slots[slot]
        seed = None if current.draw is None else current.draw.action_seed
        try:
            with self._call():
                return cast("str", self._engine.at[slot].ask(slot, "sample", seed, current.rebuilding))
        except (NotSupportedError, BridgeError, ClosedError):
            raise
        except Exception as error:
            what = error if isinstance(error, EnvFaultError) else Failure.of(error, "sample_random_action").message
            raise EnvFaultError(f"{current.name()}: {what}") from error

    # Waiting for all.

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[list[Observation], list[Info]]:
        """Begin an episode in every slot.

        Args:
            seed: Start the run of this seed over; None goes on with the present one, as with a plan half done.
            options: Passed to the first episode of every slot. ``"reset_mask"``, a bool for each slot, resets some
                only, as in Gymnasium; of the others comes what was observed last, with an empty info.

        Returns:
            The observations and the infos, one of each for every slot.

        Raises:
            ArgumentError: The run cannot start over, because its plan is an iterator that has been drawn from; or a
                mask does not fit.
            EnvFaultError: An environment failed, and ``on_error`` is ``"raise"``.
            FaultBudgetError: Environments fail again and again.
        """
        with self._call() as call:
            order, options = self._chosen(seed, options)
            if len(order) == self.num_envs:
                call.wait(self._engine.draining(), self.signal)
            batch = self._begin(self._own_source, options, order)
            call.wait_for(batch, order)
            return self._observed(order)

    async def reset_async(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[list[Observation], list[Info]]:
        """``reset`` for code that runs in an event loop, without blocking it."""
        with self._call() as call:
            order, options = self._chosen(seed, options)
            if len(order) == self.num_envs:
                await call.wait_async(self._engine.draining(blocking=False), self.signal)
            batch = self._begin(self._own_source, options, order)
            await call.wait_for_async(batch, order)
            return self._observed(order)

    def step(self, actions: Actions) -> VectorStep:
        """Step all slots, or those that a mapping names, and wait for them.

        Episodes that begin in the same call draw from the plan in the order of the slots: the order in which
        environments finish decides nothing.

        Args:
            actions: One for each slot in order; or ``{slot: action}``.

        Returns:
            What came of it, in the order asked.

        Raises:
            ArgumentError: The number of actions is not the number of slots, or a slot does not exist or is under way.
            ResetNeededError: A slot has no episode, and none begins by itself.
            EnvFaultError: An environment failed, and ``on_error`` is ``"raise"``.
            FaultBudgetError: Environments fail again and again.
        """
        with self._call() as call:
            batch, order = self._start_step(actions)
            if batch.left:
                call.wait_for(batch, order)
            return self._results(order)

    async def step_async(self, actions: Actions) -> VectorStep:
        """``step`` for code that runs in an event loop, without blocking it.

        Where it is cancelled, as by a time limit, the slots go on, and ``recv`` returns what comes of it.
        """
        with self._call() as call:
            batch, order = self._start_step(actions)
            await call.wait_for_async(batch, order)
            return self._results(order)

    # Waiting for nobody.

    def send(self, actions: Actions) -> None:
        """Begin to step all slots, or those that a mapping names; ``recv`` returns what comes of it.

        Raises:
            ArgumentError: The number of actions is not the number of slots, or a slot does not exist or is under way.
            ResetNeededError: A slot has no episode, and none begins by itself.
        """
        with self._call():
            pairs = self._checked(actions)
            self._engine.sent.update(index for index, _ in pairs)
            self._engine.act(pairs, None)

    def send_reset(self, source: EpisodeQueue | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin an episode in every slot; ``recv`` returns their observations, with reward 0 and flags false."""
        with self._call() as call:
            call.wait(self._engine.draining(), self.signal)
            self._rules.source = source or self._own_source
            self._rules.budget.finished()
            self._engine.sent.update(range(self.num_envs))
            self._engine.run_all((slot, partial(slot.begin, options)) for slot in self._slots)

    def begin_next(self, slot: int) -> None:
        """Begin the next episode of a slot; ``recv`` returns its first observation, with reward 0 and flags false."""
        self._begin_one(slot, self._slots[slot].begin)

    def give_up(self, slot: int, error: dict[str, Any] | None) -> None:
        """``begin_next`` in the middle of an episode.

        Args:
            slot: Number of the slot.
            error: What failed outside of its steps, as ``info["error"]`` says it, counted as a fault; None where
                nothing failed, as when the history is longer than the model takes.
        """
        self._begin_one(slot, partial(self._slots[slot].give_up, error))

    def _begin_one(self, slot: int, start: Start) -> None:
        with self._call():
            self._engine.refuse_busy([slot])
            self._engine.sent.add(slot)
            self._engine.run_all([(self._slots[slot], start)])

    def recv(self, min_envs: int = 1, timeout: float | None = None) -> Received:
        """Return what came of ``send``: all that is there, in order of completion.

        Args:
            min_envs: Wait for so many; for all that are under way, where these are fewer.
            timeout: Seconds to wait at most; then come those that are there, maybe none.

        Raises:
            ArgumentError: Nothing is under way.
            EnvFaultError: An environment failed, and ``on_error`` is ``"raise"``.
            FaultBudgetError: Environments fail again and again.
        """
        with self._call() as call:
            enough, deadline = self._awaited(min_envs, timeout)
            call.wait(self._engine.until(enough, deadline), self.signal)
            return self._received()

    async def recv_async(self, min_envs: int = 1, timeout: float | None = None) -> Received:
        """``recv`` for code that runs in an event loop, without blocking it."""
        with self._call() as call:
            enough, deadline = self._awaited(min_envs, timeout)
            await call.wait_async(self._engine.until(enough, deadline, blocking=False), self.signal)
            return self._received()

    def wait(self, other: Callable[[], bool] = lambda: False) -> None:
        """Wait until ``recv`` would return something, or until something else is so, as ``signal`` says it may be."""
        with self._call() as call:
            call.wait(self._engine.until(lambda: self._has_news() or other()), self.signal)

    async def wait_async(self, other: Callable[[], bool] = lambda: False) -> None:
        """``wait`` for code that runs in an event loop, without blocking it."""
        with self._call() as call:
            until = self._engine.until(lambda: self._has_news() or other(), blocking=False)
            await call.wait_async(until, self.signal)

    def _has_news(self) -> bool:
        return bool(self._engine.done)

    async def drain_async(self) -> None:
        """Wait for what is under way, and drop it, without blocking the event loop."""
        with self._call() as call:
            await call.wait_async(self._engine.draining(blocking=False), self.signal)

    @property
    def under_way(self) -> int:
        """Number of slots that were sent something and have not been received."""
        return len(self._engine.sent)

    def close(self) -> None:
        """Close every environment for good: what is asked afterwards raises ``ClosedError``."""
        self._closed = True
        with Call(self._engine, self._start_anew):
            self._engine.close()

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

    # Its own matters.

    def _chosen(self, seed: int | None, options: dict[str, Any] | None) -> tuple[list[int], dict[str, Any] | None]:
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
        return chosen, options or None

    def _begin(self, source: EpisodeQueue, options: dict[str, Any] | None, chosen: list[int]) -> Batch:
        if len(chosen) < self.num_envs:
            self._engine.refuse_busy(chosen)
        else:
            self._rules.source = source
            self._rules.budget.finished()
        batch = Batch(len(chosen))
        self._engine.run_all(
            ((self._slots[index], partial(self._slots[index].begin, options)) for index in chosen), batch
        )
        return batch

    def _start_step(self, actions: Actions) -> tuple[Batch, list[int]]:
        pairs = self._checked(actions)
        batch = Batch(len(pairs))
        self._engine.act(pairs, batch)
        return batch, [index for index, _ in pairs]

    def _checked(self, actions: Actions) -> list[tuple[int, str]]:
        pairs = indices_and_actions(actions, self.num_envs)
        self._engine.refuse_busy(index for index, _ in pairs)
        for index, _ in pairs:
            if self._slots[index].phase is not LIVE:
                self._slots[index].check_steppable()
        return pairs

    def _awaited(self, min_envs: int, timeout: float | None) -> tuple[Callable[[], bool], float | None]:
        engine = self._engine
        if not engine.sent:
            raise ArgumentError("nothing is under way; call send() before recv()")
        if type(min_envs) is not int or min_envs < 0:
            raise ArgumentError(f"min_envs must be a whole number from 0 up, not {min_envs!r}")
        wanted = min(min_envs, len(engine.sent))
        engine.target = max(1, wanted)
        return lambda: len(engine.done) >= wanted, None if timeout is None else time.monotonic() + timeout

    def _call(self) -> Call:
        if self._closed:
            raise ClosedError("the vector environment is closed; make another with make_vec")
        return Call(self._engine, self._start_anew)

    def _start_anew(self) -> None:
        """Leave the engine that an interrupt has left in the middle of something, and everything in it."""
        old = self._engine
        self._engine = old.renewed()
        if self._own_source is old.rules.source:
            self._own_source = self._engine.rules.source
        # It may hold its own locks for ever.
        threading.Thread(target=old.close, name="gem-close", daemon=True).start()

    # Results.

    def _received(self) -> Received:
        order = self._engine.take_done()
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
        # A byte for each flag, read as bools: a third of the time that NumPy takes to look at each.
        return VectorStep(
            list(observations),
            np.fromiter(rewards, np.float64, len(rewards)),
            np.frombuffer(bytearray(terminated), np.bool_),
            np.frombuffer(bytearray(truncated), np.bool_),
            list(infos),
        )

    def _observed(self, chosen: list[int]) -> tuple[list[Observation], list[Info]]:
        self._results(chosen)
        began = set(chosen)
        observations = [slot.result[0] if isinstance(slot.result, tuple) else "" for slot in self._slots]
        infos = [slot.result[4] if slot.index in began else {} for slot in self._slots]
        return observations, infos
