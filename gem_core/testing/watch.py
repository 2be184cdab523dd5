"""Time limits that name the call which exceeds them instead of hanging the checker."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class TookTooLongError(Exception):
    """A call of the environment did not come back in time; its thread was left behind."""


class _Abandoned(BaseException):
    """Ends a thread that was left behind, at its next call. Environments must not catch it."""


class _Run(Generic[T]):
    """One body in one daemon thread."""

    def __init__(self, body: Callable[[], T]) -> None:
        self.body = body
        self.done = threading.Event()
        self.value: list[T] = []
        self.error: BaseException | None = None
        self.started_s: float | None = None
        self.limit_s = 0.0
        self.thread = threading.Thread(target=self._work, name="gem-check", daemon=True)

    def _work(self) -> None:
        try:
            self.value.append(self.body())
        except BaseException as error:  # noqa: BLE001 - it is raised again in the thread that waits
            self.error = error
        finally:
            self.done.set()


class Watch:
    """Runs code in a daemon thread and limits every single call that the code makes through ``call``.

    Only the thread of a body is exchanged, not one for each call: a check makes thousands of cheap ones.
    """

    def __init__(self) -> None:
        self._live: _Run[Any] | None = None
        self._label: Callable[[], str] = str

    @property
    def last_call(self) -> str:
        """What was called last, as in ``step('hello')``."""
        return self._label()

    @property
    def is_live(self) -> bool:
        """Whether the calling thread is the one that runs a body now, and was not left behind."""
        run = self._live
        return run is not None and run.thread is threading.current_thread()

    def run(self, body: Callable[[], T]) -> T:
        """Run ``body`` to its end.

        Raises:
            TookTooLongError: A call exceeded its limit; the message names it.
        """
        run = _Run(body)
        self._live = run
        self._label = str
        run.thread.start()
        while not run.done.wait(self._remaining(run)):
            started_s = run.started_s
            if started_s is not None and time.monotonic() - started_s >= run.limit_s:
                self._live = None
                raise TookTooLongError(f"{self.last_call} gave no answer within {run.limit_s:g} s")
        self._live = None
        if run.error is not None:
            raise run.error
        return run.value[0]

    def call(
        self, label: Callable[[], str], limit_s: float, function: Callable[..., T], *args: Any, **kwargs: Any
    ) -> T:
        """Call ``function`` under a limit; ``label`` gives its name when it is needed."""
        run = self._live
        if run is None or not self.is_live:
            raise _Abandoned
        self._label = label
        run.limit_s = limit_s
        run.started_s = time.monotonic()
        try:
            return function(*args, **kwargs)
        finally:
            run.started_s = None

    def _remaining(self, run: _Run[Any]) -> float:
        started_s, limit_s = run.started_s, run.limit_s
        if started_s is None:
            return max(limit_s, 0.05)
        return max(started_s + limit_s - time.monotonic(), 0.0)
