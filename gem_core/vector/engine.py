"""``Engine``: drives the slots of a vector environment, in place or on the hosts where their environments live."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, cast

from gem_core.background import on_background_loop
from gem_core.errors import ArgumentError, BridgeError, ClosedError
from gem_core.vector.body import Body
from gem_core.vector.commands import Command, Failure, Outcome, Reset
from gem_core.vector.host import Host, Launch, free
from gem_core.vector.signal import Signal
from gem_core.vector.slot import LIVE, NEW, WAIT, FaultBudget, Rules, Slot

Start = Callable[[], Command | None]
"""Asks a slot for its first command."""

_NEVER = Signal()
"""In the place of a signal: nobody waits."""


class Engine:
    """Drives slots: what takes but microseconds at once, the rest on hosts, and takes what comes of it.

    Args:
        ids: Id of each slot's own environment.
        kwargs: Keyword arguments of each slot's own environment, over those of the run.
        rules: What the slots share.
        hosts: Where environments live.
        host_of: Tells which of the hosts those of an id live on; None where there is but one.
    """

    def __init__(
        self,
        ids: list[str | None],
        kwargs: list[Mapping[str, Any]],
        rules: Rules,
        hosts: tuple[Host, ...],
        host_of: Callable[[str | None], int] | None,
    ) -> None:
        self.rules = rules
        self.slots = [Slot(index, *own, rules) for index, own in enumerate(zip(ids, kwargs, strict=True))]
        self.hosts = hosts
        self.host_of = host_of
        self.at: list[Host] = [hosts[0]] * len(ids)
        """Where each slot's environment lives."""
        for host in hosts:
            host.engine = self
        self.signal = Signal()
        self.closed = False
        # Under the lock: which tickets are out, who waits for what, and what is done.
        self._lock = threading.RLock()
        self._tickets = [0] * len(ids)
        self._flying = [False] * len(ids)
        # Answers that are being taken, perhaps in other threads: their slots are under way until that is over.
        self._taking = 0
        self._drained = False
        self._batches: dict[int, Batch] = {}
        self._turns_due = False
        self.sent: set[int] = set()
        """Slots that were sent something and have not been received."""
        self.done: list[int] = []
        """Those of them that have a result, in order of completion."""
        self.target = 1
        """How many of them whoever waits is waiting for."""
        # When to look for what takes too long, also where there is always something to receive.
        self._look_again = 0.0
        # The bodies of slots whose steps are done at once, by the caller.
        self._quick: list[Body | None] = [None] * len(ids)

    # What is asked of it.

    def refuse_busy(self, indices: Iterable[int]) -> None:
        """Refuse what is asked of slots that something is asked of already."""
        if not self.sent and not self._batches:
            return
        for index in indices:
            if index in self.sent or index in self._batches:
                raise ArgumentError(f"slot {index} is under way; call recv() until it has come back")

    def act(self, pairs: list[tuple[int, str]], batch: Batch | None) -> None:
        """Step slots: those that take but microseconds at once, the others where they live."""
        slots, quick = self.slots, self._quick
        in_turn = batch is not None and self.rules.source.planned
        later: dict[Host, list[Launch]] = {}
        settled = 0
        for index, action in pairs:
            slot, body = slots[index], quick[index]
            if body is None or slot.phase is not LIVE:
                slot.in_turn = in_turn
                settled += self._run(slot, partial(slot.act, action), later, batch)
                continue
            outcome = body.step(action)
            if type(outcome) is tuple and not (outcome[2] or outcome[3]):
                slot.result = outcome  # as Slot.took_step would do, without the calls
                if batch is None:
                    self.done.append(index)
                settled += 1
                continue
            slot.in_turn = in_turn
            settled += self._run(slot, partial(slot.took_step, outcome), later, batch)
        self._start(later)
        if batch is not None:
            with self._lock:
                batch.left -= settled
                batch.unsettled -= settled + 1
        elif len(self.done) >= self.target:
            self.signal.set()  # another thread or task may wait already
        self._give_turns()

    def run_all(self, starts: Iterable[tuple[Slot, Start]], batch: Batch | None = None) -> None:
        """Drive slots that begin an episode, each from its first command on."""
        in_turn = batch is not None and self.rules.source.planned
        later: dict[Host, list[Launch]] = {}
        settled = 0
        for slot, start in starts:
            slot.in_turn = in_turn
            settled += self._run(slot, start, later, batch)
        self._start(later)
        if batch is not None:
            with self._lock:
                batch.left -= settled
                batch.unsettled -= settled + 1
        self._give_turns()

    def _run(self, slot: Slot, start: Start, later: dict[Host, list[Launch]], batch: Batch | None = None) -> bool:
        """Drive a slot as far as that can be done in place; note in ``later`` what a host has to do.

        Args:
            slot: Which one.
            start: Asks it for the first command.
            later: Takes what a host has to do.
            batch: What waits for the slot, if that is a call that begins here: it takes those in only that it has to
                wait for.

        Returns:
            Whether the slot has a result and the batch need not wait.
        """
        try:
            command = start()
            while command is not None:
                if command is WAIT:
                    self._hold(slot, batch)
                    return False
                body = self._quick[slot.index]
                if body is None or not body.fits(command):
                    host = self._place(slot, command)
                    body = self._quick[slot.index] = host.in_place(slot.index, command)
                    if body is None:
                        with self._lock:
                            if not slot.launch(command):  # its worker died while the command was on its way
                                command = slot.act(cast("str", command))
                                continue
                            self._tickets[slot.index] += not self._flying[slot.index]
                            self._flying[slot.index] = True
                            if batch is not None:
                                self._wait_for(slot, batch)
                            later.setdefault(host, []).append((slot.index, self._tickets[slot.index], command))
                        return False
                command = slot.took(body.perform(command))
        except Exception as error:  # noqa: BLE001 - raised again where the result is asked for
            slot.result = error
        if slot.draw is None:
            self._quick[slot.index] = None
            self.at[slot.index].release(slot.index)
        if batch is None:
            self._settle(slot.index)
        return True

    def _place(self, slot: Slot, command: Command) -> Host:
        """Return where a command is done; an environment of another id may live elsewhere than the one before."""
        present = self.at[slot.index]
        if self.host_of is None or not isinstance(command, Reset):
            return present
        host = self.hosts[self.host_of(command.env_id)]
        if host is not present:
            present.release(slot.index)
            self.at[slot.index] = host
        return host

    def _start(self, later: Mapping[Host, list[Launch]]) -> None:
        for host, launches in later.items():
            try:
                host.start(launches)
            except Exception as error:  # noqa: BLE001 - as in _run: what waits for these slots must get it
                for index, ticket, _ in launches:
                    if self._claim(index, ticket):
                        self.slots[index].result = error
                        self._settle(index)
                        self._taken()

    def _claim(self, slot: int, ticket: int) -> bool:
        with self._lock:
            if not self._flying[slot] or self._tickets[slot] != ticket:
                return False
            self._flying[slot] = False
            self._taking += 1
            return True

    def _taken(self) -> None:
        """Note that what was claimed has been dealt with."""
        with self._lock:
            self._taking -= 1
            if self._drained and not self._taking:
                self.signal.set()

    # Batches: the slots that one call waits for, and their turns.

    def _settle(self, index: int) -> None:
        """Note that a slot has a result."""
        with self._lock:
            if index in self.sent:
                self.done.append(index)
                if len(self.done) >= self.target:
                    self.signal.set()
            batch = self._batches.pop(index, None)
            if batch is not None:
                batch.left -= 1
                batch.unsettled -= 1
                if not batch.left:
                    batch.signal.set()  # the last, since whoever waits may send the slot at once

    def leave(self, batch: Batch, order: Iterable[int]) -> None:
        """Leave what a call waited for, which was cancelled or interrupted, to ``recv``; nothing of it is lost."""
        with self._lock:
            if self.closed:
                return
            self.sent.update(order)
            self.done += [index for index in order if index not in self._batches]
            self.signal.set()

    def _wait_for(self, slot: Slot, batch: Batch) -> Batch:
        """Let a batch wait for a slot; under the lock."""
        if batch.signal is _NEVER:
            batch.signal = Signal()
        self._batches[slot.index] = batch
        return batch

    def _hold(self, slot: Slot, batch: Batch | None) -> None:
        with self._lock:
            batch = self._wait_for(slot, batch) if batch else self._batches[slot.index]
            batch.waiting.append(slot.index)
            batch.unsettled -= 1
            self._turns_due = True

    def _give_turns(self) -> None:
        """Let slots that wait draw from the plan, in order, once all others of their batch have come as far."""
        while self._turns_due:
            turn: list[int] = []
            with self._lock:
                for waited in {id(one): one for one in self._batches.values()}.values():
                    if waited.waiting and not waited.unsettled:
                        turn, waited.waiting = sorted(waited.waiting), []
                        waited.unsettled = len(turn)
                        break
                else:
                    self._turns_due = any(one.waiting for one in self._batches.values())
                    return
            later: dict[Host, list[Launch]] = {}
            for index in turn:
                self._run(self.slots[index], self.slots[index].drawn, later)
            self._start(later)

    # Waiting.

    def until(
        self,
        over: Callable[[], bool],
        deadline: float | None = None,
        *,
        blocking: bool = True,
    ) -> Iterator[float | None]:
        """Yield in how many seconds to look again, until something is over; see to what takes too long."""
        while not over() or time.monotonic() >= self._look_again:
            if self.closed:
                raise ClosedError("the vector environment was closed while it was waited for; make another")
            if blocking and on_background_loop() and not over():
                raise BridgeError(
                    "a vector environment was waited for on the library's own event loop, where it would wait for "
                    "itself; await its step_async, reset_async or recv_async there instead"
                )
            now = time.monotonic()
            checks = [check for host in self.hosts if (check := self._abandon_overdue(host, now)) is not None]
            self._look_again = now + min(checks, default=math.inf)
            if over():
                return
            checks += [] if deadline is None else [deadline - now]
            seconds = min(checks, default=None)
            if deadline is not None and now >= deadline:
                return
            yield seconds

    def _abandon_overdue(self, host: Host, now: float) -> float | None:
        for index in host.overdue(now):
            slot = self.slots[index]
            with self._lock:
                # Asked again, since it may have come back, and gone on, in the meantime.
                if index not in host.overdue(now) or not self._claim(index, self._tickets[index]):
                    continue
                self._tickets[index] += 1
            later: dict[Host, list[Launch]] = {}
            try:
                self._run(slot, partial(_abandoned, slot, host), later)
                self._start(later)
                self._give_turns()
            finally:
                self._taken()
        return host.next_check(now)

    def take_done(self) -> list[int]:
        """Return the slots that were sent something and have a result; those that failed come last, one by one."""
        with self._lock:
            self.target = 1
            # What failed is raised once all that did not has been received: nothing of that is lost.
            failed = [index for index in self.done if not isinstance(self.slots[index].result, tuple)]
            order = [index for index in self.done if index not in failed] if failed else self.done
            order = order or failed[:1]
            self.done = [index for index in failed if index not in order]
            self.sent.difference_update(order)
            return order

    def close(self) -> None:
        """Cancel what is under way, and close every host for good."""
        self._forget()
        for slot in self.slots:
            slot.phase = NEW
        for host in self.hosts:
            host.close()

    def _forget(self) -> None:
        """Cancel what is under way: no answer to it is taken any more, and whoever waits for one is told."""
        with self._lock:
            self._tickets = [ticket + 1 for ticket in self._tickets]
            self._flying = [False] * len(self.slots)
            self._quick = [None] * len(self.slots)
            waiting = [self.signal, *(batch.signal for batch in self._batches.values())]
            self._batches, self.sent, self.done = {}, set(), []
            self.closed = True
        for signal in waiting:
            signal.set()

    def renewed(self) -> Engine:
        """Leave this engine; return one in its place, whose slots wait for a reset and whose plan goes on."""
        free(self._lock)
        self._forget()
        budget = FaultBudget(self.rules.budget.limit, self.rules.budget.total)
        rules = replace(self.rules, source=self.rules.source.continued(), budget=budget)
        ids, kwargs = [slot.own_id for slot in self.slots], [slot.own_kwargs for slot in self.slots]
        return Engine(ids, kwargs, rules, tuple(host.renewed() for host in self.hosts), self.host_of)

    def draining(self, *, blocking: bool = True) -> Iterator[float]:
        """Yield in how many seconds to look again, until nothing is under way; then drop what came of it."""
        self._drained = True
        for seconds in self.until(lambda: not self._taking and not any(self._flying), blocking=blocking):
            yield 0.05 if seconds is None else min(seconds, 0.05)
        with self._lock:
            self.sent, self.done, self._batches = set(), [], {}
            self._drained = False

    # What hosts tell; see ``host.Listener``.

    def advance(self, host: Host, slot: int, ticket: int, outcome: Outcome) -> Launch | None:
        """Take what came of a command; see ``host.Listener``."""
        if not self._claim(slot, ticket):
            return None
        current = self.slots[slot]
        later: dict[Host, list[Launch]] = {}
        try:
            self._run(current, partial(current.took, outcome), later)
            # What goes on in the same place needs no detour.
            here = later.pop(host, [])
            self._start(later)
            self._give_turns()
        finally:
            self._taken()
        return here[0] if here else None

    def is_current(self, slot: int, ticket: int) -> bool:
        """Tell whether an answer under this ticket is still waited for."""
        return self._flying[slot] and self._tickets[slot] == ticket

    def lose(self, host: Host, guilty: dict[int, Failure], others: list[int]) -> None:
        """Note that environments are gone; see ``host.Listener``."""
        later: dict[Host, list[Launch]] = {}
        taken = 0
        for index, failure in [*guilty.items(), *((index, None) for index in others)]:
            slot = self.slots[index]
            if self.at[index] is not host:
                continue
            with self._lock:
                claimed = self._claim(index, self._tickets[index])
                self._tickets[index] += claimed
                if not claimed:
                    slot.lost(None, under_way=False)
            if claimed:
                self._run(slot, partial(slot.lost, failure, under_way=True), later)
                taken += 1
        self._start(later)
        self._give_turns()
        for _ in range(taken):
            self._taken()

    def first_under_way(self, slots: list[int]) -> list[int]:
        """Return the first of some slots whose command is under way; see ``host.Listener``."""
        return [slot for slot in slots if self._flying[slot]][:1]

    def look_after(self, host: Host) -> float | None:
        """Give up what takes too long; see ``host.Listener``."""
        return self._abandon_overdue(host, time.monotonic())


class Batch:
    """The slots that one call waits for.

    Args:
        size: Number of slots.
    """

    def __init__(self, size: int) -> None:
        self.signal = _NEVER
        """What is set when all have a result; there is one once there is something to wait for."""
        self.left = size
        """Slots without a result."""
        self.unsettled = size + 1
        """Slots that neither have a result nor wait for their turn; and one for the call that starts them all."""
        self.waiting: list[int] = []

    def is_over(self) -> bool:
        """Tell whether all have a result."""
        return self.left == 0


def _abandoned(slot: Slot, host: Host) -> Command | None:
    return slot.lost(host.abandon(slot.index, host.timed_out(slot.index)), under_way=True)
