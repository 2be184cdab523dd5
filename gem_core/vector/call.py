"""``InterruptibleCall``: keeps a vector environment usable when Ctrl-C interrupts one of its methods."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

from gem_core.vector.scheduler import Batch, Scheduler, StepBatch
from gem_core.vector.waiting import Condition


class InterruptibleCall:
    """A context around the body of a method of a vector environment, which Ctrl-C may interrupt at any instruction.

    While the method waits, the scheduler's state is consistent: an interrupted step goes on, and ``recv`` returns its
    results. At any other instruction the scheduler's state may be half changed, perhaps by a step in place, and the
    scheduler has to be replaced. Delaying interrupts until the method returns is no alternative: an environment that
    runs in place may never return.

    Args:
        scheduler: Scheduler of the vector environment.
        replace_scheduler: Called to replace the scheduler.
    """

    __slots__ = ("_batch", "_replace_scheduler", "_scheduler", "_waits")

    def __init__(self, scheduler: Scheduler, replace_scheduler: Callable[[], None]) -> None:
        self._scheduler = scheduler
        self._replace_scheduler = replace_scheduler
        self._waits = False
        self._batch: Batch | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, traceback: object) -> None:
        if kind is None:
            return
        if not self._waits and not issubclass(kind, Exception):
            self._replace_scheduler()
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
