"""One event loop that the library owns, in a daemon thread, and the bridges to it.

Coroutines of environments and tools always run here, whoever calls, so that a connection opened in one step can be
used in the next.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import threading
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from gem_core.errors import BridgeError

T = TypeVar("T")

_lock = threading.Lock()
_loop: asyncio.AbstractEventLoop | None = None


def background_loop() -> asyncio.AbstractEventLoop:
    """Return the library's event loop, started on first use; it ends with the process."""
    global _loop
    with _lock:
        if _loop is None or _loop.is_closed():
            loop = asyncio.new_event_loop()
            threading.Thread(target=_serve, args=(loop,), name="gem-loop", daemon=True).start()
            _loop = loop
        return _loop


def run_sync(awaitable: Awaitable[T]) -> T:
    """Wait in plain code for a coroutine that runs on the library's loop.

    Raises:
        BridgeError: The caller is on that loop itself, where waiting would never end; ``await`` it instead.
    """
    loop = background_loop()
    if _running_loop() is loop:
        if hasattr(awaitable, "close"):
            awaitable.close()
        raise BridgeError(
            "a synchronous step was called on the library's own event loop, where it would wait for itself; "
            "call 'await env.step_async(action)' there instead"
        )
    future = asyncio.run_coroutine_threadsafe(_finish(awaitable), loop)
    try:
        return future.result()
    except BaseException:
        future.cancel()
        raise


async def in_thread(function: Callable[..., T], *args: Any) -> T:
    """Run a blocking function in a daemon thread of its own.

    The threads of ``asyncio.to_thread`` are joined at exit, so that one hung call would keep the interpreter alive.
    """
    future: concurrent.futures.Future[T] = concurrent.futures.Future()

    def work() -> None:
        try:
            future.set_result(function(*args))
        except BaseException as error:  # noqa: BLE001 - it is raised again in the task that waits
            future.set_exception(error)

    threading.Thread(target=work, name="gem-blocking", daemon=True).start()
    return await asyncio.wrap_future(future)


def _serve(loop: asyncio.AbstractEventLoop) -> None:
    asyncio.set_event_loop(loop)
    loop.run_forever()


def _running_loop() -> asyncio.AbstractEventLoop | None:
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None


async def _finish(awaitable: Awaitable[T]) -> T:
    return await awaitable


def _after_fork() -> None:
    # The thread of the loop does not exist in a forked child.
    global _loop, _lock
    _loop, _lock = None, threading.Lock()


def _register_fork_handler() -> None:
    import os

    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_after_fork)


_register_fork_handler()
