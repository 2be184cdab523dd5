"""``Signal``: wakes whoever waits for a vector environment, in plain code or in a coroutine."""

from __future__ import annotations

import asyncio
import queue
from contextlib import suppress


class Signal:
    """A flag that one waits for and that waiting takes down again; ``set`` may be called from any thread."""

    def __init__(self) -> None:
        # What an interrupt leaves usable at any instruction, which the lock of a threading.Event is not.
        self._flag: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._waiting: dict[asyncio.Future[None], asyncio.AbstractEventLoop] = {}

    def set(self) -> None:
        """Wake whoever waits, or the next who does."""
        if self._flag.empty():
            self._flag.put(None)
        for future, loop in list(self._waiting.items()):
            try:
                loop.call_soon_threadsafe(_finish, future)
            except RuntimeError:  # that loop is closed: nobody waits there any more
                self._waiting.pop(future, None)

    def wait(self, timeout: float | None = None) -> None:
        """Wait in plain code, at most so many seconds."""
        with suppress(queue.Empty):
            self._flag.get(timeout=timeout)

    async def wait_async(self, timeout: float | None = None) -> None:
        """Wait in a coroutine, at most so many seconds, without blocking its loop."""
        loop = asyncio.get_running_loop()
        future: asyncio.Future[None] = loop.create_future()
        self._waiting[future] = loop
        try:
            if self._flag.empty():
                await asyncio.wait([future], timeout=timeout)
        finally:
            self._waiting.pop(future, None)
        with suppress(queue.Empty):
            self._flag.get_nowait()


def _finish(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
