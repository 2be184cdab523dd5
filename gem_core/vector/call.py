"""``Call``: a call of a vector environment, which Ctrl-C may interrupt at any instruction."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

from gem_core.vector.scheduler import Batch, Scheduler, StepBatch
from gem_core.vector.waiting import Condition


class Call:
    """A call of a vector environment, as a context; an interrupt at any instruction leaves that usable.

    While the call waits, the scheduler is in order: what it waited for goes on, and comes by ``recv``. Anywhere else
    the scheduler is in the middle of something, perhaps of a step in place, and has to be replaced. To put interrupts
    off until the call is over would not do: an environment that runs in place may never come back.

    Args:
        scheduler: Of the vector environment.
        start_anew: Replaces the scheduler.
    """

    __slots__ = ("_batch", "_scheduler", "_start_anew", "_waits")

    def __init__(self, scheduler: Scheduler, start_anew: Callable[[], None]) -> None:
        self._scheduler = scheduler
        self._start_anew = start_anew
        self._waits = False
        self._batch: Batch | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, traceback: object) -> None:
        if kind is None:
            return
        if not self._waits and not issubclass(kind, Exception):
            self._start_anew()
        elif isinstance(self._batch, StepBatch):
            self._scheduler.leave(self._batch)

    def wait(self, over: Condition, batch: Batch, deadline: float | None = None) -> None:
        """Wait in plain code; see ``Scheduler.until``."""
        self._batch = batch
        for condition, seconds in self._scheduler.until(over, batch, deadline):
            self._waits = True
            self._scheduler.signal.wait(condition, seconds)
            self._waits = False
        self._batch = None

    async def wait_async(self, over: Condition, batch: Batch, deadline: float | None = None) -> None:
        """Wait in a coroutine, without blocking its loop."""
        self._batch = batch
        for condition, seconds in self._scheduler.until(over, batch, deadline, blocking=False):
            self._waits = True
            await self._scheduler.signal.wait_async(condition, seconds)
            self._waits = False
        self._batch = None
