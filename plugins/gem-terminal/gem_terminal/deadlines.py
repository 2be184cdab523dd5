"""Deadlines: what is done at a time, though the thread that should see to it hangs or never comes back."""

from __future__ import annotations

import heapq
import itertools
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from gem_core.background import DaemonPool


@dataclass(order=True)
class Deadline:
    """One of them.

    Args:
        at: When, on the monotonic clock, in seconds.
        number: Tells equal times apart.
        action: What is done then, in a thread of its own.
    """

    at: float
    number: int
    action: Callable[[], object] | None = field(compare=False)

    def cancel(self) -> None:
        """Do nothing when the time comes."""
        self.action = None


class Deadlines:
    """Waits for any number of deadlines in one thread, which ends when there are none."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._heap: list[Deadline] = []
        self._numbers = itertools.count()
        self._waiting = False
        self._actions = DaemonPool("gem-terminal-deadline", 16)

    def add(self, at: float, action: Callable[[], object]) -> Deadline:
        """Have something done at a time of ``time.monotonic``."""
        with self._changed:
            deadline = Deadline(at, next(self._numbers), action)
            heapq.heappush(self._heap, deadline)
            if not self._waiting:
                self._waiting = True
                threading.Thread(target=self._wait, name="gem-terminal-deadlines", daemon=True).start()
            self._changed.notify()
            return deadline

    def _wait(self) -> None:
        while True:
            with self._changed:
                while self._heap and self._heap[0].action is None:
                    heapq.heappop(self._heap)
                if not self._heap:
                    self._waiting = False
                    return
                rest = self._heap[0].at - time.monotonic()
                if rest > 0:
                    # Not for ever: one that was cancelled should not hold its episode in memory for hours.
                    self._changed.wait(min(rest, 60.0))
                    continue
                action = heapq.heappop(self._heap).action
            if action is not None:
                self._actions.submit(action)


_lock = threading.Lock()
_shared: Deadlines | None = None


def shared_deadlines() -> Deadlines:
    """Return those of this process."""
    global _shared
    with _lock:
        if _shared is None:
            _shared = Deadlines()
        return _shared


def _after_fork() -> None:
    # A child has not the thread, and what was to be done is its parent's.
    global _lock, _shared
    _lock, _shared = threading.Lock(), None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
