"""Calls of an environment under a time limit, in this process or in another, and the global random state."""

from __future__ import annotations

import pickle
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import numpy as np

from gem_core.background import DaemonPool
from gem_core.testing.elsewhere import Sender

T = TypeVar("T")


class TookTooLongError(BaseException):
    """A call of the environment did not return in time; its thread was abandoned.

    It is no ``Exception``, so that no promise takes it for an error of the environment.
    """


class ThreadCalls:
    """Calls in a thread other than the caller's, as vector environments make them."""

    def __init__(self) -> None:
        self.last = ""
        """The last call, as in ``step('hello')``."""
        self._pool = DaemonPool("gem-check", most=1)

    def __call__(self, label: str, limit_s: float, function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        """Call a function.

        Raises:
            TookTooLongError: It did not return in time.
        """
        self.last = label
        future = self._pool.submit(partial(function, *args, **kwargs))
        try:
            return future.result(limit_s)
        except TimeoutError:
            if future.done():  # the function itself raised it
                raise
            self._pool = DaemonPool("gem-check", most=1)
            raise TookTooLongError(f"{label} gave no answer within {limit_s:g} s") from None

    def close(self) -> None:
        """End the thread."""
        self._pool.close()


class ProcessCalls:
    """Calls in a process that tries nothing but one promise: what takes too long ends it.

    Args:
        send: To the process that waits for the result.
    """

    def __init__(self, send: Sender) -> None:
        self.last = ""
        self._send = send

    def __call__(self, label: str, limit_s: float, function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        """Call a function."""
        self.last = label
        self._send("call", label)
        self._send.allow(limit_s)
        return function(*args, **kwargs)


def global_random_state() -> dict[str, Any]:
    """Return the states of ``random`` and ``numpy.random``, in a form that can be compared."""
    return {"random": random.getstate(), "numpy.random": pickle.dumps(np.random.get_state())}


def scramble(number: int) -> None:
    """Seed ``random`` and ``numpy.random`` with ``number``."""
    random.setstate(random.Random(number).getstate())
    np.random.set_state(np.random.RandomState(number).get_state())


@contextmanager
def preserved() -> Iterator[None]:
    """Restore the global random state at the end."""
    state, numpy_state = random.getstate(), np.random.get_state()
    try:
        yield
    finally:
        random.setstate(state)
        np.random.set_state(numpy_state)
