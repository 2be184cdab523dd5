"""The global random state of the process: read, changed and put back by the checks."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np


def global_state() -> tuple[Any, Any]:
    """Return the states of ``random`` and ``numpy.random``, in a form that can be compared."""
    name, keys, *rest = np.random.get_state()
    return random.getstate(), (name, tuple(np.asarray(keys).tolist()), *rest)


def scramble(number: int) -> None:
    """Put both into a state that is decided by ``number``."""
    random.setstate(random.Random(number).getstate())
    np.random.set_state(np.random.RandomState(number).get_state())


def changed(before: tuple[Any, Any], after: tuple[Any, Any]) -> str | None:
    """Name what differs between two states, or None."""
    names = [name for name, old, new in zip(("random", "numpy.random"), before, after, strict=True) if old != new]
    return " and ".join(names) or None


@contextmanager
def preserved() -> Iterator[None]:
    """Put the global random state back at the end."""
    state, numpy_state = random.getstate(), np.random.get_state()
    try:
        yield
    finally:
        random.setstate(state)
        np.random.set_state(numpy_state)
