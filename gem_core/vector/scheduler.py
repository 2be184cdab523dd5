"""``Scheduler``: runs the commands of the slots of a vector environment, in place or by executors."""

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
from gem_core.types import Action
from gem_core.vector.commands import Command, Failure, Outcome, Reset
from gem_core.vector.executor import Executor, Launch, free
from gem_core.vector.runner import EnvRunner
from gem_core.vector.slot import LIVE, NEXT, FaultBudget, Rules, Slot
from gem_core.vector.waiting import Condition, Signal

First = Callable[[], Command | None]
"""Returns a slot's first command; see ``Slot.act``."""

Launches = dict[Executor, list[Launch]]
"""Commands that executors have to start."""


class Batch:
    """Slots that are under way, and slots with a result that ``recv`` has not collected."""

    def __init__(self) -> None:
        self.waiting: set[int] = set()
        """Slots without a result."""
        self.held: list[int] = []
        """Slots among them whose next episode has still to begin."""
        self.done: list[int] = []
        """Slots with a result, in order of completion."""

    def is_over(self) -> bool:
        """Tell whether every slot has a result."""
        return not self.waiting

    def is_due(self) -> bool:
        """Tell whether it is time for the next episodes of those that are held."""
        return bool(self.held)


class StepBatch(Batch):
    """Slots that one call steps or resets, and waits for.

    Once every slot has either a result or an ended episode, the next episodes begin in the order of slots: so the order
    of completion does not decide which slot draws which item from the plan.

    Args:
        order: The slots, in the order of the caller.
    """

    def __init__(self, order: list[int]) -> None:
        super().__init__()
        self.order = order

    def is_due(self) -> bool:
        """Tell whether it is time for the next episodes of those that are held."""
        return bool(self.held) and len(self.held) == len(self.waiting)


class Scheduler:
    """Runs the commands of slots: those that take microseconds at once, the others by executors.

    Args:
        ids: Id of each slot's own environment.
        kwargs: Keyword arguments of each slot's own environment, which override those of the run.
        rules: Rules that the slots share.
        executors: Executors in which environments live.
        executor_of: Returns the number of the executor for an id; None if there is only one executor.
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
        """Executor of each slot's environment."""
        for executor in executors:
            executor.scheduler = self
        self.signal = Signal()
        self.closed = False
        # Runners of the slots whose commands run in place, in the caller's thread.
        self._in_place: list[EnvRunner | None] = [None] * len(ids)
        # The lock protects the ticket of each slot's command that an executor runs, and the batch that each slot under
        # way belongs to. A slot has no ticket while its outcome is handled, or while its command runs in place.
        self._lock = threading.RLock()
        self._numbers = itertools.count()
        self._tickets: list[int | None] = [None] * len(ids)
        self._batches: dict[int, Batch] = {}
        self.sent = Batch()
        """The batch that ``recv`` collects."""
        self._check_at = 0.0
        """When to look again for commands that take too long."""

    # Called by the vector environment.

    def refuse_busy(self, indices: Iterable[int]) -> None:
        """Raise an error if one of some slots is under way."""
        if not self._batches:
            return
        for index in indices:
            if index in self._batches:
                raise ArgumentError(f"slot {index} is under way; call recv() until it has come back")

    def step(self, pairs: list[tuple[int, Action]], batch: Batch) -> None:
        """Step slots: those that take microseconds at once, the others by their executors."""
        slots, in_place, sent = self.slots, self._in_place, batch is self.sent
        launches: Launches = {}
        for index, action in pairs:
            slot, runner = slots[index], in_place[index]
            if runner is None or slot.phase is not LIVE:
                first = partial(slot.act, action)
            else:
                # The same as _drive, in a quarter of the time: only one stack frame besides those of the environment.
                try:
                    result = runner.env_step(action)
                except BaseException as error:  # noqa: BLE001 - raised again if it is the user's
                    first = partial(slot.take_step, runner.failed(error, "step"))
                else:
                    if not (result[2] or result[3]):
                        slot.result = result
                        if sent:
                            self._batches[index] = batch
                            batch.done.append(index)
                        continue
                    first = partial(slot.take_step, result)
            self._batches[index] = batch
            batch.waiting.add(index)
            self._drive(slot, first, launches)
        self._start(launches)
        self.signal.set()  # another thread or task may be waiting in recv

    def begin(self, indices: Iterable[int], options: dict[str, Any] | None, batch: Batch) -> None:
        """Begin an episode in each of some slots."""
        self.run([(index, partial(self.slots[index].begin, options)) for index in indices], batch)

    def run(self, firsts: list[tuple[int, First]], batch: Batch) -> None:
        """Run the commands of slots, each from its first command on."""
        launches: Launches = {}
        for index, first in firsts:
            self._batches[index] = batch
            batch.waiting.add(index)
            self._drive(self.slots[index], first, launches)
        self._start(launches)
        self.signal.set()

    def begin_run(self, source: EpisodeQueue) -> None:
        """Draw the next episodes from a source, with a full budget of faults; drop uncollected results."""
        self.drop_results()
        self.rules.source = source
        self.rules.budget.finished()

    def place(self, index: int, env_id: str | None) -> Executor:
        """Return the executor for an id in a slot; release the slot's environment in another executor, if any."""
        present = self.at[index]
        if self.executor_of is None:
            return present
        executor = self.executors[self.executor_of(env_id)]
        if executor is not present:
            present.release(index)
            self.at[index] = executor
        return executor

    def leave(self, batch: StepBatch) -> None:
        """Hand the slots of a cancelled or interrupted step over to ``recv``, with their results."""
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
        """Return the slots with a result that was not collected yet; those that failed come last, one by one."""
        with self._lock:
            # A failure is raised only after all other results have been received, so that none of them is lost.
            failed = [index for index in self.sent.done if not isinstance(self.slots[index].result, tuple)]
            order = [index for index in self.sent.done if index not in failed] if failed else self.sent.done
            order = order or failed[:1]
            self.sent.done = [index for index in failed if index not in order]
            for index in order:
                del self._batches[index]
            return order

    def close(self) -> None:
        """Cancel pending commands, and close every executor for good."""
        self._cancel()
        for executor in self.executors:
            executor.close()

    def renewed(self) -> Self:
        """Cancel pending commands; return a new scheduler whose slots wait for a reset and whose plan goes on."""
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

    # Running commands.

    def _drive(self, slot: Slot, first: First, launches: Launches) -> None:
        """Run a slot's commands in place as far as possible; add to ``launches`` the one that an executor must run."""
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
                command = slot.take_outcome(runner.perform(command))
        except Exception as error:  # noqa: BLE001 - raised again where the result is asked for
            slot.result = error
        if slot.episode is None:
            self._in_place[index] = None
            self.at[index].release(index)
        self._mark_done(index)

    def _start(self, launches: Launches) -> None:
        for executor, batch in launches.items():
            try:
                executor.start(batch)
            except Exception as error:  # noqa: BLE001 - as in _drive: raised again where the result is asked for
                for index, ticket, _ in batch:
                    if self._claim(index, ticket):
                        self.slots[index].result = error
                        self._mark_done(index)

    def _claim(self, index: int, ticket: int) -> bool:
        """Tell whether the outcome of a command is expected; accept it only once."""
        with self._lock:
            if self._tickets[index] != ticket:
                return False
            self._tickets[index] = None
            return True

    def _mark_done(self, index: int) -> None:
        """Record that a slot has a result."""
        with self._lock:
            batch = self._batches[index]
            batch.waiting.discard(index)
            if isinstance(batch, StepBatch):
                del self._batches[index]
            else:
                batch.done.append(index)

    def _hold(self, index: int) -> bool:
        """Delay a slot's next episode until the other slots of its step are done, if it has any; return whether."""
        with self._lock:
            batch = self._batches[index]
            if not isinstance(batch, StepBatch):
                return False
            batch.held.append(index)
            return True

    def _begin_held(self, batch: Batch) -> None:
        """Begin the next episodes that are due, in the order of slots; repeat for those whose reset fails in place."""
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
        """Yield a condition to wait for, and for how many seconds at most, until ``over`` is true.

        Between waits, begin the next episodes of a batch when they are due, and abandon commands that take too long.
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
        """Wait in plain code until ``over`` is true."""
        for condition, seconds in self.until(over, Batch(), blocking=False):
            self.signal.wait(condition, seconds)

    def is_idle(self) -> bool:
        """Tell whether no command is running; episodes that have still to begin do not count."""
        batches = list(self._batches.items())
        return all(index not in batch.waiting or index in batch.held for index, batch in batches)

    def drop_results(self) -> None:
        """Drop the results that were not collected, and the episodes that have still to begin."""
        with self._lock:
            self._batches = {}
            self.sent = Batch()

    # Called by executors; see ``Listener``.

    def advance(self, slot: int, ticket: int, outcome: Outcome) -> None:
        """Receive the outcome of a command; see ``Listener``."""
        if self._claim(slot, ticket):
            self._take(slot, partial(self.slots[slot].take_outcome, outcome))

    def _take(self, index: int, first: First) -> None:
        launches: Launches = {}
        self._drive(self.slots[index], first, launches)
        self._start(launches)
        self.signal.set()

    def _abandon_overdue(self) -> float | None:
        """Abandon commands that take longer than ``step_timeout``; return in how many seconds to look again."""
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
        # In a worker commands wait for one another, so the start of one may be seen only at the next look.
        self._check_at = now + min(max(0.001, oldest + limit - now), max(0.02, limit / 8))
        return self._check_at - now

    def _abandon(self, executor: Executor, index: int, limit: float) -> None:
        with self._lock:
            # Check again: the command may have finished, and the next one started, in the meantime.
            now, ticket = time.monotonic(), self._tickets[index]
            is_overdue = now - executor.running().get(index, now) >= limit
            if not is_overdue or ticket is None or not self._claim(index, ticket):
                return

        def time_out() -> Command | None:
            failure = Failure("timeout", f"a step or reset took longer than step_timeout, {limit:g} s")
            executor.abandon(index, failure)
            return self.slots[index].take_outcome(failure)

        self._take(index, time_out)
