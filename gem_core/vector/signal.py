"""``Signal``: wakes whoever waits for a vector environment, in plain code or in a coroutine."""

from __future__ import annotations

import asyncio
import threading


class Signal:
    """A flag that one waits for and that waiting takes down again; ``set`` may be called from any thread."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._waiting: dict[asyncio.Future[None], asyncio.AbstractEventLoop] = {}

    def set(self) -> None:
        """Wake whoever waits, or the next who does."""
        self._event.set()
        for future, loop in list(self._waiting.items()):
            try:
                loop.call_soon_threadsafe(_finish, future)
            except RuntimeError:  # that loop is closed: nobody waits there any more
                self._waiting.pop(future, None)

    def wait(self, timeout: float | None = None) -> None:
        """Wait in plain code, at most so many seconds."""
        self._event.wait(timeout)
        self._event.clear()

    async def wait_async(self, timeout: float | None = None) -> None:
        """Wait in a coroutine, at most so many seconds, without blocking its loop."""
        loop = asyncio.get_running_loop()
        future: asyncio.Future[None] = loop.create_future()
        self._waiting[future] = loop
        try:
            if not self._event.is_set():
                await asyncio.wait([future], timeout=timeout)
        finally:
            self._waiting.pop(future, None)
        self._event.clear()


def _finish(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
