"""``Scheduler``: drives the slots of a vector environment, in place or by the executors where environments live."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Self

from gem_core.background import on_background_loop
from gem_core.errors import ArgumentError, BridgeError, ClosedError
from gem_core.records.plans import EpisodeQueue
from gem_core.vector.commands import Command, Failure, Outcome, Reset
from gem_core.vector.executor import Executor, Launch, free
from gem_core.vector.runner import EnvRunner
from gem_core.vector.slot import LIVE, NEXT, FaultBudget, Rules, Slot
from gem_core.vector.waiting import Condition, Signal

First = Callable[[], Command | None]
"""Gives a slot's first command; see ``Slot.act``."""

Launches = dict[Executor, list[Launch]]
"""Commands that executors have to start."""


class Batch:
    """Slots that are under way, and those of them with a result that ``recv`` has not collected."""

    def __init__(self) -> None:
        self.waiting: set[int] = set()
        """Slots without a result."""
        self.held: list[int] = []
        """Those of them whose next episode has to begin."""
        self.done: list[int] = []
        """Slots with a result, in order of completion."""

    def is_over(self) -> bool:
        """Tell whether all slots have a result."""
        return not self.waiting

    def is_due(self) -> bool:
        """Tell whether it is time for the next episodes of those that are held."""
        return bool(self.held)


class StepBatch(Batch):
    """Slots that one call steps or resets, and waits for.

    The next episodes of those that end begin once all others are back, in the order of slots: so the order of
    completion does not decide which slot draws what from the plan.

    Args:
        order: The slots, as they were asked for.
    """

    def __init__(self, order: list[int]) -> None:
        super().__init__()
        self.order = order

    def is_due(self) -> bool:
        """Tell whether it is time for the next episodes of those that are held."""
        return bool(self.held) and len(self.held) == len(self.waiting)


class Scheduler:
    """Drives slots: what takes but microseconds at once, the rest by executors, and takes the outcomes.

    Args:
        ids: Id of each slot's own environment.
        kwargs: Keyword arguments of each slot's own environment, over those of the run.
        rules: What the slots share.
        executors: Where environments live.
        executor_of: Tells which of the executors those of an id live in; None where there is but one.
    """

    def __init__(
        self,
        ids: list[str | None],
        kwargs: list[Mapping[str, Any]],
        rules: Rules,
        executors: tuple[Executor, ...],
        executor_of: Callable[[str | None], int] | None,
    ) -> None:
        self.rules = rules
        self.slots = [Slot(index, *own, rules) for index, own in enumerate(zip(ids, kwargs, strict=True))]
        self.executors = executors
        self.executor_of = executor_of
        self.at: list[Executor] = [executors[0]] * len(ids)
        """Where each slot's environment lives."""
        for executor in executors:
            executor.scheduler = self
        self.signal = Signal()
        self.closed = False
        # The runners of slots whose steps are done at once, by the caller.
        self._in_place: list[EnvRunner | None] = [None] * len(ids)
        # Under the lock: which commands are out, and which batch a slot is under way in. While an outcome is taken, and
        # while a command is done in place, none is out.
        self._lock = threading.RLock()
        self._numbers = itertools.count()
        self._tickets: list[int | None] = [None] * len(ids)
        self._batches: dict[int, Batch] = {}
        self.sent = Batch()
        """What ``recv`` collects."""
        self._check_at = 0.0
        """When to look again for what takes too long."""

    # What is asked of it.

    def refuse_busy(self, indices: Iterable[int]) -> None:
        """Refuse what is asked of slots that are under way."""
        if not self._batches:
            return
        for index in indices:
            if index in self._batches:
                raise ArgumentError(f"slot {index} is under way; call recv() until it has come back")

    def step(self, pairs: list[tuple[int, str]], batch: Batch) -> None:
        """Step slots: those that take but microseconds at once, the others where they live."""
        slots, in_place, sent = self.slots, self._in_place, batch is self.sent
        launches: Launches = {}
        for index, action in pairs:
            slot, runner = slots[index], in_place[index]
            if runner is None or slot.phase is not LIVE:
                first = partial(slot.act, action)
            else:
                # As _drive would do, in a quarter of the time: one frame beside those of the environment.
                try:
                    result = runner.env_step(action)
                except BaseException as error:  # noqa: BLE001 - raised again if it is the user's
                    first = partial(slot.took_step, runner.failed(error, "step"))
                else:
                    if not (result[2] or result[3]):
                        slot.result = result
                        if sent:
                            self._batches[index] = batch
                            batch.done.append(index)
                        continue
                    first = partial(slot.took_step, result)
            self._batches[index] = batch
            batch.waiting.add(index)
            self._drive(slot, first, launches)
        self._start(launches)
        self.signal.set()  # another thread or task may wait for those that were sent

    def begin(self, indices: Iterable[int], options: dict[str, Any] | None, batch: Batch) -> None:
        """Begin an episode in slots."""
        self.run([(index, partial(self.slots[index].begin, options)) for index in indices], batch)

    def run(self, firsts: list[tuple[int, First]], batch: Batch) -> None:
        """Drive slots, each from its first command on."""
        launches: Launches = {}
        for index, first in firsts:
            self._batches[index] = batch
            batch.waiting.add(index)
            self._drive(self.slots[index], first, launches)
        self._start(launches)
        self.signal.set()

    def begin_run(self, source: EpisodeQueue) -> None:
        """Let the next episodes start from a source, with the whole budget of faults; results left over are dropped."""
        self.drop_results()
        self.rules.source = source
        self.rules.budget.finished()

    def place(self, index: int, env_id: str | None) -> Executor:
        """Return where a slot's environment of an id lives; one of another id may have lived elsewhere before."""
        present = self.at[index]
        if self.executor_of is None:
            return present
        executor = self.executors[self.executor_of(env_id)]
        if executor is not present:
            present.release(index)
            self.at[index] = executor
        return executor

    def leave(self, batch: StepBatch) -> None:
        """Leave the slots of a step, which was cancelled or interrupted, to ``recv``; nothing of it is lost."""
        with self._lock:
            if self.closed:
                return
            for index in batch.order:
                self._batches[index] = self.sent
            self.sent.done += [index for index in batch.order if index not in batch.waiting]
            self.sent.waiting |= batch.waiting
            self.sent.held += batch.held
        self.signal.set()

    def collect(self) -> list[int]:
        """Return the slots that were sent something and have a result; those that failed come last, one by one."""
        with self._lock:
            # What failed is raised once all that did not has been received: nothing of that is lost.
            failed = [index for index in self.sent.done if not isinstance(self.slots[index].result, tuple)]
            order = [index for index in self.sent.done if index not in failed] if failed else self.sent.done
            order = order or failed[:1]
            self.sent.done = [index for index in failed if index not in order]
            for index in order:
                del self._batches[index]
            return order

    def close(self) -> None:
        """Cancel what is under way, and close every executor for good."""
        self._cancel()
        for executor in self.executors:
            executor.close()

    def renewed(self) -> Self:
        """Cancel what is under way; return a scheduler whose slots wait for a reset and whose plan goes on."""
        free(self._lock)
        self._cancel()
        budget = FaultBudget(self.rules.budget.limit, self.rules.budget.total)
        rules = replace(self.rules, source=self.rules.source.continued(), budget=budget)
        ids, kwargs = [slot.own_id for slot in self.slots], [slot.own_kwargs for slot in self.slots]
        executors = tuple(executor.renewed() for executor in self.executors)
        return type(self)(ids, kwargs, rules, executors, self.executor_of)

    def _cancel(self) -> None:
        with self._lock:
            self._tickets = [None] * len(self.slots)
            self._in_place = [None] * len(self.slots)
            self.closed = True
        self.signal.set()

    # Driving slots.

    def _drive(self, slot: Slot, first: First, launches: Launches) -> None:
        """Drive a slot as far as that can be done in place; note in ``launches`` what an executor has to start."""
        index = slot.index
        try:
            command = first()
            while command is not None:
                if self.closed:
                    return
                if command is NEXT:
                    if self._hold(index):
                        return
                    command = slot.next_episode()
                    continue
                runner = self._in_place[index]
                if runner is None or not runner.fits(command):
                    executor = self.place(index, command.env_id) if isinstance(command, Reset) else self.at[index]
                    runner = self._in_place[index] = executor.in_place(index, command)
                    if runner is None:
                        ticket = self._tickets[index] = next(self._numbers)
                        launches.setdefault(executor, []).append((index, ticket, command))
                        return
                command = slot.took(runner.perform(command))
        except Exception as error:  # noqa: BLE001 - raised again where the result is asked for
            slot.result = error
        if slot.episode is None:
            self._in_place[index] = None
            self.at[index].release(index)
        self._settle(index)

    def _start(self, launches: Launches) -> None:
        for executor, batch in launches.items():
            try:
                executor.start(batch)
            except Exception as error:  # noqa: BLE001 - as in _drive: what waits for these slots must get it
                for index, ticket, _ in batch:
                    if self._claim(index, ticket):
                        self.slots[index].result = error
                        self._settle(index)

    def _claim(self, index: int, ticket: int) -> bool:
        """Tell whether the outcome of a command is waited for; no other is taken then."""
        with self._lock:
            if self._tickets[index] != ticket:
                return False
            self._tickets[index] = None
            return True

    def _settle(self, index: int) -> None:
        """Note that a slot has a result."""
        with self._lock:
            batch = self._batches[index]
            batch.waiting.discard(index)
            if isinstance(batch, StepBatch):
                del self._batches[index]
            else:
                batch.done.append(index)

    def _hold(self, index: int) -> bool:
        """Put off the next episode of a slot until all others of its step are back; return whether that is so."""
        with self._lock:
            batch = self._batches[index]
            if not isinstance(batch, StepBatch):
                return False
            batch.held.append(index)
            return True

    def _begin_held(self, batch: Batch) -> None:
        """Begin the next episodes that are due, in the order of slots; again for those whose reset fails in place."""
        while batch.is_due():
            with self._lock:
                due, batch.held = sorted(batch.held), []
            launches: Launches = {}
            for index in due:
                self._drive(self.slots[index], self.slots[index].next_episode, launches)
            self._start(launches)

    # Waiting.

    def until(
        self, over: Condition, batch: Batch, deadline: float | None = None, *, blocking: bool = True
    ) -> Iterator[tuple[Condition, float | None]]:
        """Yield what to wait for, and how many seconds at most, until something is over.

        Meanwhile it begins the next episodes of a batch when they are due, and abandons what takes too long.
        """

        def due() -> bool:
            return over() or self.closed or batch.is_due()

        while True:
            self._begin_held(batch)
            seconds = self._abandon_overdue()
            if over():
                return
            if self.closed:
                raise ClosedError("the vector environment was closed while it was waited for; make another")
            if blocking and on_background_loop():
                raise BridgeError(
                    "a vector environment was waited for on the library's own event loop, where it would wait for "
                    "itself; await its step_async, reset_async or recv_async there instead"
                )
            if deadline is not None:
                left = deadline - time.monotonic()
                if left <= 0:
                    return
                seconds = left if seconds is None else min(seconds, left)
            yield due, seconds

    def wait(self, over: Condition) -> None:
        """Wait in plain code until something is over."""
        for condition, seconds in self.until(over, Batch(), blocking=False):
            self.signal.wait(condition, seconds)

    def is_idle(self) -> bool:
        """Tell whether nothing is under way, apart from next episodes that have not begun."""
        batches = list(self._batches.items())
        return all(index not in batch.waiting or index in batch.held for index, batch in batches)

    def drop_results(self) -> None:
        """Forget the results that nobody has collected, and the episodes that have not begun."""
        with self._lock:
            self._batches = {}
            self.sent = Batch()

    # What executors tell; see ``Listener``.

    def advance(self, slot: int, ticket: int, outcome: Outcome) -> None:
        """Take the outcome of a command; see ``Listener``."""
        if self._claim(slot, ticket):
            self._take(slot, partial(self.slots[slot].took, outcome))

    def _take(self, index: int, first: First) -> None:
        launches: Launches = {}
        self._drive(self.slots[index], first, launches)
        self._start(launches)
        self.signal.set()

    def _abandon_overdue(self) -> float | None:
        """Abandon what takes longer than ``step_timeout``; return in how many seconds to look again."""
        limit = self.rules.step_timeout
        if limit is None:
            return None
        now = time.monotonic()
        if now < self._check_at:
            return self._check_at - now
        oldest = now
        for executor in self.executors:
            for index, since in executor.running().items():
                if now - since >= limit:
                    self._abandon(executor, index, limit)
                else:
                    oldest = min(oldest, since)
        # In a worker commands wait for one another, and how long one takes may be known only a look later.
        self._check_at = now + min(max(0.001, oldest + limit - now), max(0.02, limit / 8))
        return self._check_at - now

    def _abandon(self, executor: Executor, index: int, limit: float) -> None:
        with self._lock:
            # Asked again, since it may have come back, and gone on, in the meantime.
            now, ticket = time.monotonic(), self._tickets[index]
            is_overdue = now - executor.running().get(index, now) >= limit
            if not is_overdue or ticket is None or not self._claim(index, ticket):
                return

        def took() -> Command | None:
            failure = Failure("timeout", f"a step or reset took longer than step_timeout, {limit:g} s")
            executor.abandon(index, failure)
            return self.slots[index].took(failure)

        self._take(index, took)
