"""``Fence``: gives each game of TextArena generators of its own, in place of the global ones that it draws from."""

from __future__ import annotations

import copy
import random
import threading
from functools import cached_property
from typing import Any

import numpy as np

LOCK = threading.RLock()
"""Held during every call into TextArena, in the whole process."""


class Fence:
    """The generators of one game, from which the library draws inside of it; the lock is held there."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._outer: list[Fence | None] = []
        self.python = random.Random(seed)

    @cached_property
    def numpy(self) -> np.random.RandomState:
        """What takes the place of ``numpy.random``; made when it is first asked for, since few games do."""
        return np.random.RandomState(self._seed % 2**32)

    def copy(self) -> Fence:
        """Return a fence in the same state, to try something out."""
        return copy.deepcopy(self)

    def __enter__(self) -> None:
        global _current
        LOCK.acquire()
        self._outer.append(_current)
        _current = self

    def __exit__(self, *_: object) -> None:
        global _current
        _current = self._outer.pop()
        LOCK.release()


_current: Fence | None = None


class _Random:
    """Stands for the module ``random`` in modules of the library."""

    def __getattr__(self, name: str) -> Any:
        if not hasattr(random.Random, name):
            return getattr(random, name)

        def draw(*args: Any, **kwargs: Any) -> Any:
            # Looked up anew, since Secretary keeps the function.
            return getattr(random if _current is None else _current.python, name)(*args, **kwargs)

        setattr(self, name, draw)
        return draw


class _Numpy:
    """Stands for the module ``numpy`` in modules of the library."""

    def __getattr__(self, name: str) -> Any:
        return _current.numpy if _current is not None and name == "random" else getattr(np, name)


STAND_INS = {"random": _Random(), "np": _Numpy(), "numpy": _Numpy()}
"""What takes the place of these names in each module of the library."""
