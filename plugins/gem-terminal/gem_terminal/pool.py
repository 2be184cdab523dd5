"""The pool: machines started before they are needed, one queue for each task; and what an environment holds."""

from __future__ import annotations

import atexit
import collections
import contextlib
import logging
import os
import threading
import time
import weakref
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from gem_core.background import DaemonPool

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend, Limits, Machine
    from gem_terminal.tasks.task import Task

logger = logging.getLogger(__name__)

_CLOSING_S = 60.0
"""Longest wait, when an environment closes, for starts and removals that are under way."""

_AT_ONCE = 4
"""Starts in the background at once, and removals."""


@dataclass(eq=False)
class _Queue:
    """The machines of one task on one backend with the same limits."""

    backend: Backend
    task: Task
    limits: Limits
    wanted: int = 0
    """How many are to be ready."""
    starting: int = 0
    """Starts that are under way, or wait for a thread."""
    waiting: int = 0
    """Those who wait for one of them."""
    ready: deque[tuple[Machine, float]] = field(default_factory=deque)
    """Machines that are ready, each with the time since when."""
    users: set[object] = field(default_factory=set)

    @property
    def memory_mb(self) -> float:
        """Megabytes that the main container of each may take."""
        return self.limits.share(self.task.environment.main).memory_mb


class MachinePool:
    """Machines that are ready, by backend, content of the task, and limits.

    Who takes one gets a machine that is ready, or one whose start is under way; else it is started in the caller's own
    thread, which so gets the error of a start that fails. A start that nobody waits for is done in the background;
    where it fails, that is logged, and the next to take one tries again.

    Args:
        most: Ready machines at once, in all.
        most_memory_mb: Sum of the memory limits of ready machines; None for the memory of this computer.
        idle_s: Seconds after which a ready machine makes room for others.
    """

    def __init__(self, *, most: int = 32, most_memory_mb: int | None = None, idle_s: float = 300.0) -> None:
        self._most, self._idle_s = most, idle_s
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        self._most_mb = memory // 2**20 if most_memory_mb is None else most_memory_mb
        self._changed = threading.Condition()
        self._queues: dict[tuple[int, str, Limits], _Queue] = {}
        self._removing: collections.Counter[object] = collections.Counter()
        """How many machines are being removed that each user has given back."""

        self._starts = DaemonPool("gem-terminal-start", _AT_ONCE)
        self._removals = DaemonPool("gem-terminal-remove", _AT_ONCE)

    def take(self, user: object, backend: Backend, task: Task, limits: Limits, *, ready: int = 1) -> Machine:
        """Return a machine that nothing has touched.

        Args:
            user: On whose behalf; what it alone has had made ready is removed once it leaves.
            backend: Starts it.
            task: Its task.
            limits: Its limits.
            ready: Machines of this kind to have ready afterwards.

        Raises:
            MachineError, TaskError: The start failed.
        """
        queue = self._queue(user, backend, task, limits)
        queue.wanted = ready
        try:
            while (machine := self._next(queue)) is not None:
                if machine.why_lost() is None:
                    return machine
                self.discard(user, machine)
            return backend.start(task, limits)
        finally:
            self._start_spares(queue)

    def prestart(self, user: object, backend: Backend, task: Task, limits: Limits, *, ready: int = 1) -> None:
        """Have machines made ready, without waiting for them."""
        queue = self._queue(user, backend, task, limits)
        queue.wanted = max(queue.wanted, ready)
        self._start_spares(queue)

    def discard(self, user: object, machine: Machine) -> None:
        """Remove a machine in the background; ``leave`` waits for it."""
        with self._changed:
            self._removing[user] += 1
        self._removals.submit(partial(self._remove, machine, user))

    def leave(self, user: object) -> None:
        """Remove what this user alone has had made ready, and wait until that, and what it has discarded, is gone."""
        with self._changed:
            left = []
            for key, queue in list(self._queues.items()):
                queue.users.discard(user)
                if not queue.users:
                    left.append(self._queues.pop(key))
                    while queue.ready:
                        self.discard(user, queue.ready.popleft()[0])
            if not self._changed.wait_for(
                lambda: not self._removing[user] and not any(queue.starting for queue in left), _CLOSING_S
            ):
                logger.warning("gem-terminal: machines are still being started or removed after %.0f s", _CLOSING_S)
            if not self._removing[user]:
                del self._removing[user]

    def _queue(self, user: object, backend: Backend, task: Task, limits: Limits) -> _Queue:
        with self._changed:
            queue = self._queues.setdefault((id(backend), task.digest, limits), _Queue(backend, task, limits))
            queue.users.add(user)
            return queue

    def _next(self, queue: _Queue) -> Machine | None:
        """Return the next machine of a queue; None when none is ready, nor will be by a start that is under way."""
        with self._changed:
            queue.waiting += 1
            try:
                self._changed.wait_for(lambda: queue.ready or queue.starting < queue.waiting)
                return queue.ready.popleft()[0] if queue.ready else None
            finally:
                queue.waiting -= 1

    def _start_spares(self, queue: _Queue) -> None:
        with self._changed:
            self._drop_idle()
            while (
                queue.users and len(queue.ready) + queue.starting < queue.wanted + queue.waiting and self._fits(queue)
            ):
                queue.starting += 1
                self._starts.submit(partial(self._start, queue))

    def _fits(self, queue: _Queue) -> bool:
        spares = [(len(other.ready) + other.starting, other.memory_mb) for other in self._queues.values()]
        memory_mb = sum(number * each_mb for number, each_mb in spares)
        return sum(number for number, _ in spares) < self._most and memory_mb + queue.memory_mb <= self._most_mb

    def _drop_idle(self) -> None:
        before = time.monotonic() - self._idle_s
        for queue in self._queues.values():
            while queue.ready and queue.ready[0][1] <= before:
                self.discard(next(iter(queue.users)), queue.ready.popleft()[0])

    def _start(self, queue: _Queue) -> None:
        machine: Machine | None = None
        try:
            machine = queue.backend.start(queue.task, queue.limits)
        except Exception as error:  # noqa: BLE001 - whoever takes the next machine gets it
            if queue.users:
                logger.warning("gem-terminal: a machine of the task %s did not start: %s", queue.task.name, error)
        with self._changed:
            if machine is not None and queue.users:
                queue.ready.append((machine, time.monotonic()))
                machine = None
        if machine is not None:
            machine.remove()
        with self._changed:
            queue.starting -= 1
            self._changed.notify_all()

    def _remove(self, machine: Machine, user: object) -> None:
        try:
            machine.remove()
        except Exception:
            logger.exception("gem-terminal: the machine %s could not be removed", machine.id)
        finally:
            with self._changed:
                self._removing[user] -= 1
                self._changed.notify_all()


_shared = MachinePool()


def shared_pool() -> MachinePool:
    """Return the pool of this process."""
    return _shared


class Holdings:
    """What one environment holds of a pool: given back when it is closed, forgotten, or the interpreter exits.

    Args:
        owner: The environment; when it is collected without having been closed, all is given back in a thread.
        pool: Where the machines come from.
    """

    def __init__(self, owner: object, pool: MachinePool) -> None:
        self._pool = pool
        self._pid = os.getpid()
        self._machines: set[Machine] = set()
        self._collected = weakref.finalize(owner, self._release_in_background)
        self._collected.atexit = False
        _all.add(self)

    def take(self, backend: Backend, task: Task, limits: Limits, ready: int) -> Machine:
        """Return a machine of the pool; see ``MachinePool.take``."""
        machine = self._pool.take(self, backend, task, limits, ready=ready)
        self._machines.add(machine)
        return machine

    def prestart(self, backend: Backend, task: Task, limits: Limits, ready: int) -> None:
        """Have machines made ready; see ``MachinePool.prestart``."""
        self._pool.prestart(self, backend, task, limits, ready=ready)

    def give_back(self, machine: Machine) -> None:
        """Have a machine removed in the background, unless it was given back before."""
        with contextlib.suppress(KeyError):
            self._machines.remove(machine)
            if os.getpid() == self._pid:  # what a forked child has is its parent's
                self._pool.discard(self, machine)

    def give_all_back(self) -> None:
        """Have all machines removed in the background."""
        for machine in list(self._machines):
            self.give_back(machine)

    def release(self) -> None:
        """Give everything back, and wait until it is gone; it may be used again afterwards."""
        self.give_all_back()
        if os.getpid() == self._pid:
            self._pool.leave(self)

    def _release_in_background(self) -> None:
        # The garbage collector may run in any thread, with any lock held.
        with contextlib.suppress(RuntimeError):  # the interpreter ends: what is done at exit sees to it
            threading.Thread(target=self.release, name="gem-terminal-forgotten", daemon=True).start()


_all: weakref.WeakSet[Holdings] = weakref.WeakSet()


@atexit.register
def _release_all() -> None:
    everything = list(_all)
    for holdings in everything:  # all at once, and only then one after another
        holdings.give_all_back()
    for holdings in everything:
        holdings.release()


def _after_fork() -> None:
    # A child has none of the threads, and the machines are its parent's: it must neither use nor remove them.
    global _shared
    _shared = MachinePool()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
