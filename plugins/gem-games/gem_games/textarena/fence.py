"""``Fence``: keeps the global random state that TextArena draws from apart from everyone else's."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

LOCK = threading.RLock()
"""Held during every call into TextArena, in the whole process."""


class Fence:
    """The global random state of one game: put in place for each call into it, and put aside again."""

    def __init__(self, seed: int) -> None:
        self._python = random.Random(seed).getstate()
        self._numpy = np.random.RandomState(seed % 2**32).get_state()

    def copy(self) -> Fence:
        """Return a fence in the same state, to try something out."""
        other = Fence.__new__(Fence)
        other._python, other._numpy = self._python, self._numpy
        return other

    @contextmanager
    def inside(self) -> Iterator[None]:
        """Hold the lock and the game's random state; the caller's is put back whatever happens."""
        with LOCK:
            outer = random.getstate(), np.random.get_state()
            random.setstate(self._python)
            np.random.set_state(self._numpy)
            try:
                yield
            finally:
                self._python, self._numpy = random.getstate(), np.random.get_state()
                random.setstate(outer[0])
                np.random.set_state(outer[1])

    @contextmanager
    def outside(self) -> Iterator[None]:
        """Inside of ``inside``, run foreign code that must not draw from the game's random state."""
        inner = random.getstate(), np.random.get_state()
        try:
            yield
        finally:
            random.setstate(inner[0])
            np.random.set_state(inner[1])
