"""The pool: machines that are started before they are needed, shared by all environments of a process.

A reset takes a machine that is ready, and the next one is started in the background. All starting and removing happens
in threads of the pool, so that Ctrl-C in the main thread never cuts a start in two.
"""

from __future__ import annotations

import atexit
import logging
import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from gem_core.background import DaemonPool
from gem_terminal.errors import MachineError

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend, Limits, Machine
    from gem_terminal.tasks.task import Task

logger = logging.getLogger(__name__)

_CLOSING_S = 60.0
"""Longest wait, when an environment closes, for starts and removals that are under way."""

Submit = Callable[[Callable[[], object]], None]
User = object
"""Stands for an environment: what it alone has used is removed once it leaves."""


@dataclass(eq=False)
class Ticket:
    """What a reset waits for."""

    user: User
    future: Future[Machine] = field(default_factory=Future)


@dataclass(eq=False)
class _Shelf:
    """The machines of one task on one backend with the same limits."""

    backend: Backend
    task: Task
    limits: Limits
    wanted: int = 0
    users: set[User] = field(default_factory=set)
    left_by: User = None
    """Who left it last, and waits for what is still under way."""
    ready: deque[tuple[Machine, float]] = field(default_factory=deque)
    waiting: deque[Ticket] = field(default_factory=deque)
    under_way: int = 0
    """Starts that are queued or running."""
    taken: float = -math.inf
    taken_before: float = -math.inf

    @property
    def spare(self) -> int:
        """How many machines there are, or will be, that nobody waits for."""
        return len(self.ready) + max(0, self.under_way - len(self.waiting))


@dataclass
class PoolCounts:
    """What a pool has done: ``hits`` found a machine ready, ``misses`` waited for one; and what it holds now."""

    hits: int = 0
    misses: int = 0
    failed: int = 0
    dropped: int = 0
    ready: int = 0
    under_way: int = 0


class MachinePool:
    """Machines that are ready, by backend, content of the task, and limits.

    Who asks first is served first. A start that fails is raised in the reset that waits for it; one that nobody waits
    for is logged, and tried again by the next reset. Machines that nobody has taken for long are removed. Where there
    is no more room, a task that is asked for more often takes the place of one that is asked for less.

    Args:
        most: Ready machines at once, in all.
        most_memory_mb: Sum of the memory limits of ready machines; None for the memory of this computer.
        idle_s: Seconds after which a ready machine is removed.
        starts: Starts at once.
        clock: Tells the time in seconds.
        submit: Runs work in the background; None for threads of the pool.
    """

    def __init__(
        self,
        *,
        most: int = 32,
        most_memory_mb: int | None = None,
        idle_s: float = 300.0,
        starts: int = 4,
        clock: Callable[[], float] = time.monotonic,
        submit: Submit | None = None,
    ) -> None:
        self._most, self._idle_s, self._clock = most, idle_s, clock
        self._most_mb = _memory_mb() if most_memory_mb is None else most_memory_mb
        self._changed = threading.Condition()
        self._shelves: dict[tuple[int, str, Limits], _Shelf] = {}
        self._urgent: deque[_Shelf] = deque()
        self._spares: deque[_Shelf] = deque()
        self._removing: dict[int, set[User]] = {}
        """Who waits for each machine that is being removed when leaving, by the machine's identity."""
        self._counts = PoolCounts()
        self._sweeps = submit is None
        self._sweeping = False
        self._submit: Submit = DaemonPool("gem-terminal-start", starts).submit if submit is None else submit
        self._submit_removal: Submit = DaemonPool("gem-terminal-remove", starts).submit if submit is None else submit

    def take(self, user: User, backend: Backend, task: Task, limits: Limits, *, ready: int = 1) -> Machine:
        """Return a machine that nothing has touched: one that is ready, or the next that is started.

        Args:
            user: On whose behalf; see ``leave``.
            backend: Starts it.
            task: Its task.
            limits: Its limits.
            ready: Machines of this kind to have ready afterwards.

        Raises:
            MachineError, TaskError: The start failed.
        """
        ticket = self.ask(user, backend, task, limits, ready=ready)
        try:
            return ticket.future.result()
        except BaseException:
            self.withdraw(ticket)
            raise

    def ask(self, user: User, backend: Backend, task: Task, limits: Limits, *, ready: int = 1) -> Ticket:
        """Do what ``take`` does without waiting: the future of the ticket has the machine or the error."""
        ticket = Ticket(user)
        with self._changed:
            shelf = self._shelf(user, backend, task, limits)
            shelf.wanted = ready
            shelf.taken_before, shelf.taken = shelf.taken, self._clock()
        while True:
            with self._changed:
                machine = shelf.ready.popleft()[0] if shelf.ready else None
                if machine is None:
                    self._counts.misses += 1
                    shelf.waiting.append(ticket)
                    self._start_for_waiting(shelf)
                    self._start_spares(shelf)
                    return ticket
            if machine.why_lost() is None:
                break
            self.discard(user, machine)
        with self._changed:
            self._counts.hits += 1
            self._start_spares(shelf)
        ticket.future.set_result(machine)
        return ticket

    def withdraw(self, ticket: Ticket) -> None:
        """Take back what was asked for; the machine, if there is one by now, is removed."""
        with self._changed:
            for shelf in self._shelves.values():
                if ticket in shelf.waiting:
                    shelf.waiting.remove(ticket)
                    return
        if ticket.future.done() and ticket.future.exception() is None:
            self.discard(ticket.user, ticket.future.result())

    def prestart(self, user: User, backend: Backend, task: Task, limits: Limits, *, ready: int = 1) -> None:
        """Have machines made ready, without waiting for them."""
        with self._changed:
            shelf = self._shelf(user, backend, task, limits)
            shelf.wanted = max(shelf.wanted, ready)
            self._start_spares(shelf)

    def discard(self, user: User, machine: Machine) -> None:
        """Remove a machine in the background; ``leave`` waits for it."""
        with self._changed:
            self._give_up(machine, {user})

    def leave(self, user: User, *, wait_s: float = _CLOSING_S) -> None:
        """Remove what this user alone has had made ready, and wait until that, and what it has discarded, is gone."""
        with self._changed:
            left = []
            for key, shelf in list(self._shelves.items()):
                shelf.users.discard(user)
                if not shelf.users:
                    shelf.left_by = user
                    left.append(self._shelves.pop(key))
                    self._empty(shelf)
            deadline = time.monotonic() + wait_s
            while any(shelf.under_way for shelf in left) or any(user in users for users in self._removing.values()):
                if (rest := deadline - time.monotonic()) <= 0 or not self._changed.wait(rest):
                    logger.warning("gem-terminal: machines are still being started or removed after %.0f s", wait_s)
                    return

    def close(self, *, wait_s: float = _CLOSING_S) -> None:
        """Remove all that is ready or being started, whoever uses it; the pool can be used again."""
        everyone = object()
        with self._changed:
            for shelf in self._shelves.values():
                shelf.users = {everyone}
            for users in self._removing.values():
                users.add(everyone)
        self.leave(everyone, wait_s=wait_s)

    def sweep(self) -> None:
        """Remove machines that have been ready for too long."""
        with self._changed:
            before = self._clock() - self._idle_s
            for shelf in self._shelves.values():
                while shelf.ready and shelf.ready[0][1] <= before:
                    shelf.wanted = 0
                    self._drop(shelf)

    def counts(self) -> PoolCounts:
        """Return what it has done and holds."""
        with self._changed:
            shelves = self._shelves.values()
            self._counts.ready = sum(len(shelf.ready) for shelf in shelves)
            self._counts.under_way = sum(shelf.under_way for shelf in shelves)
            return PoolCounts(**vars(self._counts))

    # What follows is called with the lock held, but for _work and _remove.

    def _shelf(self, user: User, backend: Backend, task: Task, limits: Limits) -> _Shelf:
        key = (id(backend), task.digest, limits)
        shelf = self._shelves.get(key)
        if shelf is None:
            shelf = self._shelves[key] = _Shelf(backend, task, limits)
        shelf.users.add(user)
        return shelf

    def _start_for_waiting(self, shelf: _Shelf) -> None:
        if shelf.under_way < len(shelf.waiting):
            shelf.under_way += 1
            self._urgent.append(shelf)
            self._submit(self._work)
        elif shelf in self._spares:  # what was for later is needed now
            self._spares.remove(shelf)
            self._urgent.append(shelf)

    def _start_spares(self, shelf: _Shelf) -> None:
        while shelf.spare < shelf.wanted and self._room_for(shelf):
            shelf.under_way += 1
            self._spares.append(shelf)
            self._submit(self._work)

    def _room_for(self, shelf: _Shelf) -> bool:
        while not self._fits(shelf):
            # One that was taken less lately than this one was before: a task asked for once drives nobody out.
            others = [other for other in self._shelves.values() if other.ready and other.taken < shelf.taken_before]
            if not others:
                return False
            self._drop(min(others, key=lambda other: other.taken))
        return True

    def _fits(self, shelf: _Shelf) -> bool:
        shelves = list(self._shelves.values())
        number = sum(other.spare for other in shelves)
        memory = sum(other.spare * other.limits.memory_mb for other in shelves)
        return number < self._most and memory + shelf.limits.memory_mb <= self._most_mb

    def _drop(self, shelf: _Shelf) -> None:
        machine, _ = shelf.ready.popleft()
        self._counts.dropped += 1
        self._give_up(machine, {*shelf.users, shelf.left_by})

    def _give_up(self, machine: Machine, users: set[User]) -> None:
        self._removing[id(machine)] = users
        self._submit_removal(partial(self._remove, machine))

    def _empty(self, shelf: _Shelf) -> None:
        while shelf.ready:
            self._drop(shelf)
        for queue in (self._urgent, self._spares):
            while shelf in queue:
                queue.remove(shelf)
                shelf.under_way -= 1
        for ticket in shelf.waiting:
            ticket.future.set_exception(MachineError("the environment was closed while its machine was started"))
        shelf.waiting.clear()

    def _work(self) -> None:
        with self._changed:
            queue = self._urgent or self._spares
            if not queue:
                return
            shelf = queue.popleft()
        try:
            machine = shelf.backend.start(shelf.task, shelf.limits)
        except BaseException as error:  # noqa: BLE001 - it is raised in the reset that waits
            with self._changed:
                self._failed(shelf, error)
        else:
            with self._changed:
                self._arrived(shelf, machine)

    def _failed(self, shelf: _Shelf, error: BaseException) -> None:
        shelf.under_way -= 1
        self._counts.failed += 1
        if shelf.waiting:
            shelf.waiting.popleft().future.set_exception(error)
        elif shelf.users:
            logger.warning("gem-terminal: a machine of the task %s did not start: %s", shelf.task.name, error)
        self._changed.notify_all()

    def _arrived(self, shelf: _Shelf, machine: Machine) -> None:
        shelf.under_way -= 1
        if shelf.waiting:
            shelf.waiting.popleft().future.set_result(machine)
        elif shelf.users and len(shelf.ready) < shelf.wanted:
            shelf.ready.append((machine, self._clock()))
            self._sweep_in_time()
        else:
            self._counts.dropped += 1
            self._give_up(machine, {*shelf.users, shelf.left_by})
        self._changed.notify_all()

    def _remove(self, machine: Machine) -> None:
        try:
            machine.remove()
        except Exception:
            logger.exception("gem-terminal: the machine %s could not be removed", machine.id)
        finally:
            with self._changed:
                self._removing.pop(id(machine), None)
                self._changed.notify_all()

    def _sweep_in_time(self) -> None:
        if self._sweeps and not self._sweeping:
            self._sweeping = True
            threading.Thread(target=self._keep_sweeping, name="gem-terminal-sweep", daemon=True).start()

    def _keep_sweeping(self) -> None:
        while True:
            with self._changed:
                since = [shelf.ready[0][1] for shelf in self._shelves.values() if shelf.ready]
                if not since:
                    self._sweeping = False
                    return
                self._changed.wait(max(0.1, min(since) + self._idle_s - self._clock()))
            self.sweep()


def _memory_mb() -> int:
    try:
        return int(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20)
    except (AttributeError, OSError, ValueError):  # no such figure on this system
        return 16_384


_lock = threading.Lock()
_shared: MachinePool | None = None


def shared_pool() -> MachinePool:
    """Return the pool of this process, which is emptied when the interpreter exits."""
    global _shared
    with _lock:
        if _shared is None:
            _shared = MachinePool()
            atexit.register(_shared.close)
        return _shared


def _after_fork() -> None:
    # A child has none of the threads, and the machines are its parent's: it must neither use nor remove them.
    global _lock, _shared
    if _shared is not None:
        atexit.unregister(_shared.close)
    _lock, _shared = threading.Lock(), None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
