"""Time limits, and saving of the global random state, so that promises do not disturb each other or the caller."""

from __future__ import annotations

import math
import pickle
import random
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import numpy as np

T = TypeVar("T")


class TookTooLongError(Exception):
    """A call of the environment did not return in time; its thread was abandoned."""


class _AbandonedError(BaseException):
    """Ends an abandoned thread at its next call. Environments must not catch it."""


class _BodyThread(threading.Thread, Generic[T]):
    """Runs a function in a daemon thread.

    Args:
        function: What is run.
    """

    def __init__(self, function: Callable[[], T]) -> None:
        super().__init__(name="gem-check", daemon=True)
        self.future: Future[T] = Future()
        self.call: Callable[[], str] = str
        """Returns the name of the present or last call."""
        self.limit_s = self.deadline = math.inf
        self._function = function

    def run(self) -> None:
        try:
            self.future.set_result(self._function())
        except BaseException as error:  # noqa: BLE001 - it is raised again in the thread that waits
            self.future.set_exception(error)


class Watch:
    """Runs code in a daemon thread and limits every single call that the code makes through ``call``.

    One thread runs a whole promise, not a single call: a check makes thousands of cheap ones.
    """

    def __init__(self) -> None:
        self._body: _BodyThread[Any] | None = None

    @property
    def last_call(self) -> str:
        """What was called last, as in ``step('hello')``."""
        return "" if self._body is None else self._body.call()

    @property
    def is_live(self) -> bool:
        """Whether the calling thread is the one that runs a function now, and was not abandoned."""
        return threading.current_thread() is self._body

    def run(self, function: Callable[[], T]) -> T:
        """Run ``function`` to its end.

        Raises:
            TookTooLongError: A call exceeded its limit; the message names it.
        """
        body = _BodyThread(function)
        self._body = body
        body.start()
        try:
            while not wait([body.future], 0.05).done:
                if time.monotonic() >= body.deadline:
                    raise TookTooLongError(f"{body.call()} gave no answer within {body.limit_s:g} s")
            return body.future.result()
        finally:
            self._body = None

    def call(
        self, label: Callable[[], str], limit_s: float, function: Callable[..., T], *args: Any, **kwargs: Any
    ) -> T:
        """Call ``function`` under a limit; ``label`` gives its name when it is needed."""
        body = self._body
        if body is None or not self.is_live:
            raise _AbandonedError
        body.call, body.limit_s, body.deadline = label, limit_s, time.monotonic() + limit_s
        try:
            return function(*args, **kwargs)
        finally:
            body.deadline = math.inf


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
