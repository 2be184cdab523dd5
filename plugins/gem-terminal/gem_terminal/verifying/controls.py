"""Trials of a task's tests on untouched machines: who is to blame when there is no verdict."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gem_terminal.verifying.verdict import Verdict

Key = tuple[str, str, str]
"""Version of the task, name of the step, name of the backend."""


class Controls:
    """Verdicts of untouched machines, each found once. For several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._locks: dict[Key, threading.Lock] = {}
        self._known: dict[Key, Verdict] = {}

    def get(self, key: Key, attempt: Callable[[], Verdict]) -> Verdict:
        """Return the verdict that belongs to ``key``; of several threads one makes the attempt, and the others wait.

        An attempt that raises, or whose machine was lost, says nothing of the task, and is made again the next time.
        """
        with self._lock:
            lock = self._locks.setdefault(key, threading.Lock())
        with lock:
            verdict = self._known.get(key)
            if verdict is None:
                verdict = attempt()
                if verdict.problem != "machine":
                    self._known[key] = verdict
            return verdict

    def forget(self) -> None:
        """Forget all verdicts."""
        with self._lock:
            self._known.clear()


CONTROLS = Controls()
"""Those of this process."""
