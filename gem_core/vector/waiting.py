"""``Signal``: wakes threads and coroutines that wait for a vector environment."""

from __future__ import annotations

import asyncio
import queue
from collections.abc import Callable
from contextlib import suppress

Condition = Callable[[], bool]
"""Tells whether to stop waiting; called from any thread, so it must not change anything."""


class Signal:
    """Wakes waiting threads and coroutines, each when its condition is met.

    It has no lock: an interrupt at any instruction could leave the lock of a ``threading.Event`` held.
    """

    def __init__(self) -> None:
        self._waiting: dict[object, tuple[Condition, Callable[[], None]]] = {}

    def set(self) -> None:
        """Wake the waiting whose condition is met; may be called from any thread."""
        for condition, wake in list(self._waiting.values()):
            # Checked here: otherwise each of 512 slots that finish one by one would wake the thread that waits for all.
            if condition():
                wake()

    def wait(self, condition: Condition, timeout: float | None = None) -> None:
        """Wait in plain code until a condition is met, at most so many seconds."""
        flag: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._waiting[flag] = condition, lambda: flag.put(None)
        try:
            if not condition():
                with suppress(queue.Empty):
                    flag.get(timeout=timeout)
        finally:
            self._waiting.pop(flag, None)

    async def wait_async(self, condition: Condition, timeout: float | None = None) -> None:
        """Wait in a coroutine until a condition is met, at most so many seconds, without blocking its loop."""
        loop, flag = asyncio.get_running_loop(), asyncio.Event()

        def wake() -> None:
            with suppress(RuntimeError):  # the event loop is closed, so nobody waits there
                loop.call_soon_threadsafe(flag.set)

        self._waiting[flag] = condition, wake
        try:
            if not condition():
                with suppress(TimeoutError):
                    async with asyncio.timeout(timeout):
                        await flag.wait()
        finally:
            self._waiting.pop(flag, None)
