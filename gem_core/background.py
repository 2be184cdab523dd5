"""The library's own event loop, in a daemon thread, and the bridges to it.

Coroutines of environments and tools always run on it, so that a connection opened in one step can be used in the next.
Its globals are those of a process: there is one loop, and what was started on it without anyone waiting.
"""

from __future__ import annotations

import asyncio
import contextvars
import queue
import threading
import weakref
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, TypeVar, cast

from gem_core.errors import ArgumentError, BridgeError

T = TypeVar("T")

_CANCELLING_S = 6.0
"""Seconds that a coroutine may take to end when the plain code that waits for it is interrupted."""

_plain = threading.local()
"""``loop``: the event loop in whose thread ``run_without_loop`` runs a coroutine now, which must not wait for it."""

_lock = threading.Lock()
_loop: asyncio.AbstractEventLoop | None = None
_scheduled: set[asyncio.Future[Any]] = set()
"""Tasks without a waiter; a loop keeps only weak references to its own."""

_parent_loops: list[object] = []
"""The parent's loop and tasks, kept alive in a forked child: closing them would change the parent's epoll set."""


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
    if asyncio._get_running_loop() is loop:
        if hasattr(awaitable, "close"):
            awaitable.close()
        raise BridgeError(
            "plain code cannot wait on the library's own event loop, where it would wait for itself; use the "
            "asynchronous form there, as in 'await env.step_async(action)'"
        )
    work = awaitable if asyncio.iscoroutine(awaitable) else _finish(awaitable)
    future = asyncio.run_coroutine_threadsafe(work, loop)
    try:
        return future.result()
    except BaseException:
        future.cancel()
        raise


def run_without_loop(coroutine: Coroutine[Any, Any, T], otherwise: str = "plain code cannot wait here") -> T:
    """Return the result of a coroutine that never waits, in plain code.

    ``in_thread``, ``on_library_loop`` and ``side_by_side`` do not wait in it: they return when their work is done.

    Args:
        coroutine: The coroutine.
        otherwise: Message of the error if it waits.

    Raises:
        ArgumentError: It waits for something.
    """
    outer = getattr(_plain, "loop", None)
    _plain.loop = asyncio._get_running_loop()
    try:
        coroutine.send(None)
    except StopIteration as finished:
        return cast("T", finished.value)
    finally:
        _plain.loop = outer
    coroutine.close()
    raise ArgumentError(otherwise)


def _in_plain_code() -> bool:
    """Tell whether the coroutine that calls is run by ``run_without_loop``."""
    loop = asyncio._get_running_loop()
    return loop is None or loop is getattr(_plain, "loop", None)


def run_or_schedule(awaitable: Awaitable[object]) -> None:
    """Run a coroutine to its end in plain code; on the library's loop itself, schedule it without waiting.

    For cleaning up, which may be called anywhere: the garbage collector runs in any thread.
    """
    if asyncio._get_running_loop() is background_loop():
        task = asyncio.ensure_future(awaitable)
        _scheduled.add(task)
        task.add_done_callback(_scheduled.discard)
    else:
        run_sync(awaitable)


def close_later(resource: Any, loop: asyncio.AbstractEventLoop) -> None:
    """Close what belongs to a loop and whose owner was forgotten, such as a session of connections.

    For ``weakref.finalize``, which may call it in any thread and at the end of the interpreter.

    Args:
        resource: Has ``closed``, and ``close()`` as a coroutine function.
        loop: On which it is closed; nothing is done where that does not run any more.
    """
    if resource.closed or not loop.is_running():
        return
    closing = asyncio.run_coroutine_threadsafe(_finish(resource.close()), loop)
    if asyncio._get_running_loop() is not loop:
        try:
            closing.result(timeout=1.0)
        except (TimeoutError, OSError):
            closing.cancel()


async def on_library_loop(awaitable: Awaitable[T]) -> T:
    """Await on the library's loop, from whichever loop the caller runs on; without a hop on the library's own."""
    if _in_plain_code():
        return run_sync(awaitable)
    loop = background_loop()
    if asyncio.get_running_loop() is loop:
        return await awaitable
    return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(_finish(awaitable), loop))


async def within(limit_s: float, work: Awaitable[T]) -> T:
    """Await work for a limited time; then it is cancelled, and not waited for any longer.

    Raises:
        TimeoutError: The limit has passed.
    """
    task = asyncio.ensure_future(work)
    try:
        done, _ = await asyncio.wait({task}, timeout=limit_s)
    except asyncio.CancelledError:
        task.cancel()
        raise
    if not done:
        task.cancel()
        await asyncio.sleep(0)  # so that it learns of it
        raise TimeoutError(f"it took longer than {limit_s:g} s")
    return task.result()


async def in_thread(function: Callable[..., T], *args: Any) -> T:
    """Run a blocking function in a daemon thread of its own.

    The threads of ``asyncio.to_thread`` are joined at exit, so that one hung call would keep the interpreter alive.
    """
    if _in_plain_code():
        return function(*args)
    future: Future[T] = Future()
    future.set_running_or_notify_cancel()  # it runs, even if nobody waits for its result any more
    context = contextvars.copy_context()
    work = (future, context.run, _called, function, *args)
    threading.Thread(target=_settle, args=work, name="gem-blocking", daemon=True).start()
    return await asyncio.wrap_future(future)


def _settle(future: Future[Any], function: Callable[..., Any], *args: Any) -> None:
    """Call a function, and give a future its result or its error."""
    try:
        future.set_result(function(*args))
    except BaseException as error:  # noqa: BLE001 - it is raised again where the future is waited for
        future.set_exception(error)


def _called(function: Callable[..., T], *args: Any) -> T:
    """Call a function for a future, which refuses a ``StopIteration``: its waiter would wait for ever."""
    try:
        return function(*args)
    except StopIteration as error:
        raise RuntimeError(f"{getattr(function, '__qualname__', function)} raised StopIteration") from error


async def side_by_side(jobs: Mapping[str, Coroutine[Any, Any, T]]) -> dict[str, T]:
    """Return the results of coroutines by name; if one fails, the others are cancelled. Plain code runs one by one."""
    if _in_plain_code() or not jobs:
        try:
            return {name: await job for name, job in jobs.items()}
        finally:
            for job in jobs.values():
                job.close()  # those behind one that failed
    tasks = {name: asyncio.ensure_future(job) for name, job in jobs.items()}
    try:
        await asyncio.wait(tasks.values(), return_when=asyncio.FIRST_EXCEPTION)
        return {name: task.result() for name, task in tasks.items() if task.done()}
    finally:
        for task in tasks.values():
            task.cancel()


class Door:
    """The way of plain code into coroutines: they run on the library's own loop, and what they call ``here`` runs here.

    So an agent or an environment that is no coroutine is called in the thread of the caller, where no event loop runs,
    while the caller waits in ``run``.
    """

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[tuple[Future[Any], Callable[..., Any], tuple[Any, ...]] | None] = (
            queue.SimpleQueue()
        )
        self.interrupted = False
        """Whether plain code was interrupted while it waited; what is called to clean up then runs in other threads."""

    async def here(self, function: Callable[..., T], *args: Any) -> T:
        """Call a function in the thread that waits in ``run``."""
        if self.interrupted:
            return await in_thread(function, *args)
        future: Future[T] = Future()
        self._calls.put((future, function, args))
        return await asyncio.wrap_future(future)

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Wait in plain code for a coroutine; an interrupt cancels it.

        Raises:
            BridgeError: The caller is on the library's loop itself.
        """
        if on_background_loop():
            work.close()
            raise BridgeError(
                "plain code cannot wait on the library's own event loop, where it would wait for itself; "
                "use the asynchronous form there, such as arollout"
            )

        async def until_the_end() -> T:
            try:
                return await work
            finally:
                self._calls.put(None)

        outcome = asyncio.run_coroutine_threadsafe(until_the_end(), background_loop())
        try:
            while (call := self._calls.get()) is not None:
                future, function, args = call
                if future.set_running_or_notify_cancel():
                    try:
                        future.set_result(_called(function, *args))
                    except Exception as error:  # noqa: BLE001 - it is raised again in the coroutine that waits
                        future.set_exception(error)
        except BaseException:
            self.interrupted = True
            outcome.cancel()
            with suppress(queue.Empty):
                while (call := self._calls.get(timeout=_CANCELLING_S)) is not None:
                    call[0].cancel()
            raise
        return outcome.result()


class DaemonPool:
    """A pool of daemon threads, as many as are needed at once, which do not delay the exit of the interpreter.

    The threads of ``concurrent.futures`` are joined at exit, so that one hung job would keep the interpreter alive.
    They end when the pool is closed, or collected by the garbage collector.

    Args:
        name: Name of the threads.
        most: Threads at once; further work waits for one.
    """

    def __init__(self, name: str, most: int = 1024) -> None:
        self._name, self._most, self._threads = name, most, 0
        self._lock = threading.Lock()
        self._idle = threading.Semaphore(0)
        self._jobs: _Jobs = queue.SimpleQueue()
        self.close = weakref.finalize(self, self._jobs.put, None)
        self.close.atexit = False

    def submit(self, function: Callable[..., T], *args: Any) -> Future[T]:
        """Call a function in a thread; it can be cancelled until then."""
        future: Future[T] = Future()
        self._jobs.put((future, function, args))
        with self._lock:
            if not self._idle.acquire(blocking=False) and self._threads < self._most:
                self._threads += 1
                work = self._jobs, self._idle
                threading.Thread(target=_work_off, args=work, name=self._name, daemon=True).start()
        return future


_Jobs = queue.SimpleQueue[tuple[Future[Any], Callable[..., Any], tuple[Any, ...]] | None]


def _work_off(jobs: _Jobs, idle: threading.Semaphore) -> None:
    while (job := jobs.get()) is not None:
        if job[0].set_running_or_notify_cancel():
            _settle(job[0], job[1], *job[2])
        del job  # an idle thread must not keep its last job alive
        idle.release()
    jobs.put(None)  # for the next thread


def _serve(loop: asyncio.AbstractEventLoop) -> None:
    asyncio.set_event_loop(loop)
    while not loop.is_closed():
        try:
            loop.run_forever()
        except (SystemExit, KeyboardInterrupt):
            # asyncio lets these two out of a task, which ends the loop. The task's own waiter gets them there; every
            # other waiter would wait for ever if the loop did not go on.
            continue
        return


def on_background_loop() -> bool:
    """Tell whether the caller runs on the library's own event loop."""
    return _loop is not None and asyncio._get_running_loop() is _loop


async def _finish(awaitable: Awaitable[T]) -> T:
    return await awaitable


def _after_fork() -> None:
    # The thread of the loop does not exist in a forked child.
    global _loop, _lock
    _parent_loops.append(_loop)
    _parent_loops.extend(_scheduled)
    _scheduled.clear()
    _loop, _lock = None, threading.Lock()


def _register_fork_handler() -> None:
    import os

    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_after_fork)


_register_fork_handler()
