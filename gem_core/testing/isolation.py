"""Time limits of calls, in this process and in another, and the global random state."""

from __future__ import annotations

import math
import pickle
import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from gem_core.testing.interpreter import Sender

T = TypeVar("T")


class TookTooLongError(Exception):
    """A call of the environment did not return in time; its thread was abandoned."""


class _AbandonedError(BaseException):
    """Ends an abandoned thread at its next call. Environments must not catch it."""


class Watch:
    """Runs a promise in a daemon thread, and limits every single call that it makes through ``call``."""

    def __init__(self) -> None:
        self.last_call = ""
        """What was called last, as in ``step('hello')``."""
        self._thread: threading.Thread | None = None
        self._limit_s = self._deadline = math.inf

    @property
    def is_live(self) -> bool:
        """Whether the calling thread is the one that runs a promise now, and was not abandoned."""
        return threading.current_thread() is self._thread

    def run(self, function: Callable[[], object]) -> None:
        """Run ``function`` to its end.

        Raises:
            TookTooLongError: A call exceeded its limit; the message names it.
        """
        errors: list[BaseException] = []

        def body() -> None:
            try:
                function()
            except BaseException as error:  # noqa: BLE001 - it is raised again in the thread that waits
                errors.append(error)

        self._deadline = math.inf
        self._thread = thread = threading.Thread(target=body, name="gem-check", daemon=True)
        thread.start()
        try:
            while thread.is_alive():
                thread.join(0.05)
                if thread.is_alive() and time.monotonic() >= self._deadline:
                    raise TookTooLongError(f"{self.last_call} gave no answer within {self._limit_s:g} s")
        finally:
            self._thread = None
        if errors:
            raise errors[0]

    def call(self, label: str, limit_s: float, function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        """Call ``function`` under a limit."""
        if not self.is_live:
            raise _AbandonedError
        self.last_call, self._limit_s, self._deadline = label, limit_s, time.monotonic() + limit_s
        try:
            return function(*args, **kwargs)
        finally:
            if self.is_live:
                self._deadline = math.inf


class ProcessWatch(Watch):
    """Limits every call of a process that runs nothing but one promise: what takes too long ends it.

    Args:
        send: To the process that waits for the result.
    """

    def __init__(self, send: Sender) -> None:
        super().__init__()
        self._send = send

    def call(self, label: str, limit_s: float, function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        """Call ``function`` under a limit."""
        self.last_call = label
        self._send(("call", label))
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
