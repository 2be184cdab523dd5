"""``Holdings``: the machines that an environment has, given back when it is closed, forgotten, or at exit."""

from __future__ import annotations

import atexit
import contextlib
import os
import threading
import weakref
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Backend, Limits, Machine
    from gem_terminal.pool import MachinePool
    from gem_terminal.tasks.task import Task

_all: weakref.WeakSet[Holdings] = weakref.WeakSet()


class Holdings:
    """What one environment holds of a pool.

    Args:
        owner: The environment; when it is collected without having been closed, all is given back in a thread.
        pool: Where the machines come from.
    """

    def __init__(self, owner: object, pool: MachinePool) -> None:
        self._pool = pool
        self._pid = os.getpid()
        self._lock = threading.Lock()
        self._machines: set[Machine] = set()
        self._collected = weakref.finalize(owner, self._release_in_background)
        self._collected.atexit = False
        _all.add(self)

    def take(self, backend: Backend, task: Task, limits: Limits, ready: int) -> Machine:
        """Return a machine of the pool; see ``MachinePool.take``."""
        machine = self._pool.take(self, backend, task, limits, ready=ready)
        with self._lock:
            self._machines.add(machine)
        return machine

    def prestart(self, backend: Backend, task: Task, limits: Limits, ready: int) -> None:
        """Have machines made ready; see ``MachinePool.prestart``."""
        self._pool.prestart(self, backend, task, limits, ready=ready)

    def give_back(self, machine: Machine) -> None:
        """Have a machine removed in the background."""
        with self._lock:
            if machine not in self._machines:
                return
            self._machines.discard(machine)
        if os.getpid() == self._pid:
            self._pool.discard(self, machine)

    def release(self) -> None:
        """Give everything back, and wait until it is gone; it may be used again afterwards."""
        self.give_all_back()
        if os.getpid() == self._pid:
            self._pool.leave(self)

    def give_all_back(self) -> None:
        """Have all machines removed in the background."""
        with self._lock:
            machines, self._machines = self._machines, set()
        if os.getpid() == self._pid:  # what a forked child has is its parent's
            for machine in machines:
                self._pool.discard(self, machine)

    def _release_in_background(self) -> None:
        # The garbage collector may run in any thread, with any lock held.
        if os.getpid() == self._pid:
            with contextlib.suppress(RuntimeError):  # the interpreter ends: what is done at exit sees to it
                threading.Thread(target=self.release, name="gem-terminal-forgotten", daemon=True).start()


@atexit.register
def _release_all() -> None:
    everything = list(_all)
    for holdings in everything:  # all at once, and only then one after another
        holdings.give_all_back()
    for holdings in everything:
        holdings.release()
