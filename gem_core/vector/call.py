"""``Call``: a call of a vector environment, which Ctrl-C may interrupt at any instruction."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Self

from gem_core.vector.engine import Batch, Engine
from gem_core.vector.signal import Signal


class Call:
    """A call of a vector environment, as a context; an interrupt at any instruction leaves that usable.

    While the call waits, the engine is in order: what it waited for goes on, and comes by ``recv``. Anywhere else the
    engine is in the middle of something, perhaps of a step in place, and has to be replaced. To put interrupts off
    until the call is over would not do: an environment that runs in place may never come back.

    Args:
        engine: Of the vector environment.
        start_anew: Replaces the engine.
    """

    __slots__ = ("_batch", "_engine", "_order", "_start_anew", "_waits")

    def __init__(self, engine: Engine, start_anew: Callable[[], None]) -> None:
        self._engine = engine
        self._start_anew = start_anew
        self._waits = False
        self._batch: Batch | None = None
        self._order: Iterable[int] = ()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, traceback: object) -> None:
        if kind is None:
            return
        if not self._waits and not issubclass(kind, Exception):
            self._start_anew()
        elif self._batch is not None:
            self._engine.leave(self._batch, self._order)

    def wait(self, until: Iterator[float | None], signal: Signal) -> None:
        """Wait in plain code; see ``Engine.until``."""
        for seconds in until:
            self._waits = True
            signal.wait(seconds)
            self._waits = False

    async def wait_async(self, until: Iterator[float | None], signal: Signal) -> None:
        """Wait in a coroutine, without blocking its loop."""
        for seconds in until:
            self._waits = True
            await signal.wait_async(seconds)
            self._waits = False

    def wait_for(self, batch: Batch, order: Iterable[int]) -> None:
        """Wait in plain code until all slots of a batch have a result."""
        self._batch, self._order = batch, order
        self.wait(self._engine.until(batch.is_over), batch.signal)
        self._batch = None

    async def wait_for_async(self, batch: Batch, order: Iterable[int]) -> None:
        """Wait in a coroutine until all slots of a batch have a result."""
        self._batch, self._order = batch, order
        until = self._engine.until(batch.is_over, blocking=False)
        await self.wait_async(until, batch.signal)
        self._batch = None
