"""The library's own event loop, and the bridges to it."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from concurrent.futures import Future
from typing import Any

import pytest

from gem_core.background import (
    Door,
    background_loop,
    in_thread,
    on_library_loop,
    run_sync,
    run_without_loop,
    side_by_side,
)


async def where() -> asyncio.AbstractEventLoop:
    """Return the loop that runs it."""
    return asyncio.get_running_loop()


def test_run_sync_runs_on_the_library_loop() -> None:
    """A coroutine that plain code waits for runs on the library's loop."""
    assert run_sync(where()) is background_loop()


def test_run_sync_works_inside_another_loop() -> None:
    """Plain code that is called from somebody's own loop may wait as well."""

    async def main() -> Any:
        return run_sync(where())

    assert asyncio.run(main()) is background_loop()


def test_run_without_loop_does_in_place_what_coroutines_would_wait_for() -> None:
    """Threads, the library's loop and coroutines side by side, also inside of somebody's own loop."""

    async def work() -> list[Any]:
        one_by_one = side_by_side({"a": where_now(), "b": where_now()})
        return [await in_thread(threading.current_thread), await on_library_loop(where()), await one_by_one]

    async def where_now() -> threading.Thread:
        return threading.current_thread()

    async def main() -> list[Any]:
        return run_without_loop(work())

    here = threading.current_thread()
    expected = [here, background_loop(), {"a": here, "b": here}]
    assert run_without_loop(work()) == asyncio.run(main()) == expected


def test_interrupt_cancels_the_coroutine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while plain code waits stops the coroutine as well."""
    started, cancelled = threading.Event(), threading.Event()

    async def wait_forever() -> None:
        started.set()
        try:
            await asyncio.Event().wait()
        finally:
            cancelled.set()

    def interrupted(self: Future[Any], timeout: float | None = None) -> None:
        started.wait()
        raise KeyboardInterrupt

    monkeypatch.setattr(Future, "result", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_sync(wait_forever())
    assert cancelled.wait(30)


def test_on_library_loop_hops_and_comes_back() -> None:
    """A coroutine awaited from another loop runs on the library's, and its result comes back."""

    async def main() -> tuple[bool, bool]:
        own = asyncio.get_running_loop()
        hopped = await on_library_loop(where())
        return hopped is background_loop(), asyncio.get_running_loop() is own

    assert asyncio.run(main()) == (True, True)


def test_in_thread_runs_elsewhere() -> None:
    """A blocking function runs in a daemon thread with its arguments."""

    async def main() -> Any:
        return await in_thread(lambda word: (word, threading.current_thread()), "x")

    word, thread = asyncio.run(main())
    assert word == "x"
    assert thread.daemon
    assert thread is not threading.current_thread()


@pytest.mark.parametrize(
    ("error", "text"),
    [(ValueError("inside"), "inside"), (StopIteration(), "fail_so raised StopIteration")],
)
def test_in_thread_passes_the_error_on(error: Exception, text: str) -> None:
    """The error of a function comes to whoever waits; StopIteration, which no task may raise, as RuntimeError."""

    def fail_so() -> None:
        raise error

    with pytest.raises((ValueError, RuntimeError), match=f"{text}$"):
        asyncio.run(asyncio.wait_for(in_thread(fail_so), 30))


def test_stop_iteration_in_the_callers_thread_comes_to_who_waits() -> None:
    """As of an agent whose answers are used up."""
    door = Door()
    with pytest.raises(RuntimeError):
        door.run(asyncio.wait_for(door.here(next, iter(())), 30))


def test_cancelled_wait_leaves_no_trace(capfd: pytest.CaptureFixture[str]) -> None:
    """A thread whose waiter was cancelled ends in silence, with a result or an error."""
    release = threading.Event()
    threads: list[threading.Thread] = []

    def block(error: Exception | None) -> None:
        threads.append(threading.current_thread())
        release.wait()
        if error:
            raise error

    async def main() -> None:
        for error in (None, ValueError("late")):
            count = len(threads)
            task = asyncio.ensure_future(in_thread(block, error))
            while len(threads) == count:
                await asyncio.sleep(0)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    asyncio.run(main())
    release.set()
    for thread in threads:
        thread.join()
    assert capfd.readouterr().err == ""


FORK = """
import os
from gem_core.background import run_sync

async def two():
    return 2

run_sync(two())
child = os.fork()
if child == 0:
    os._exit(run_sync(two()))
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="this system has no fork")
def test_forked_child_has_a_loop_of_its_own() -> None:
    """A child that was forked after the loop had started can use the bridge."""
    code = f"import warnings\nwarnings.simplefilter('ignore')\n{FORK}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "2\n"


@pytest.mark.parametrize("error", [SystemExit(3), KeyboardInterrupt()])
def test_exit_inside_a_coroutine_leaves_the_loop_running(error: BaseException) -> None:
    """Whoever waits gets it, and the next coroutine runs as ever, instead of never."""

    async def leave() -> None:
        raise error

    with pytest.raises(type(error)):
        run_sync(leave())
    ran = Future[bool]()
    threading.Thread(target=lambda: ran.set_result(run_sync(where()) is background_loop()), daemon=True).start()
    assert ran.result(timeout=30)
