"""A process that works: requests come in on a connection, and answers go out on it.

It has the same hash seed everywhere, and its work has limits that hold whatever it does: a timer of the kernel that
ends it, and a limit of memory. So there are two processes: one that has imported what is needed and waits, and its
child, which works. When the child is ended, the other says so and starts the next, at the cost of a fork.
"""

from __future__ import annotations

import gc
import importlib
import json
import mmap
import os
import resource
import signal
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

_MORE_BYTES = 1 << 30
"""Memory that a child may take on top of what it begins with."""
_MOST_REQUESTS, _RENEWED = 5000, 3
"""After so many requests a child makes room for a fresh one, since libraries have caches that grow; its exit code."""

Handle = Callable[[dict[str, Any]], dict[str, Any]]


def main() -> None:
    """Serve until the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    caller = Connection(int(sys.argv[2]))
    try:
        handle: Handle = importlib.import_module(sys.argv[1]).load()
    except Exception as error:  # noqa: BLE001 - whatever keeps a library from loading is told
        _send(caller, {"failed": f"{type(error).__name__}: {error}"})
        return
    _send(caller, {"ready": True})
    _supervise(caller, handle)


def _send(caller: Connection, message: dict[str, Any]) -> None:
    caller.send_bytes(json.dumps(message).encode("ascii"))


def _supervise(caller: Connection, handle: Handle) -> None:
    """Have a child work, and answer in its place when it was ended."""
    gc.collect()
    gc.freeze()
    busy = mmap.mmap(-1, 1)  # shared with the child: whether it has a request in hand
    while True:
        child = os.fork()
        if child == 0:
            _work(caller, handle, busy)
        _, status = os.waitpid(child, 0)
        if busy[0]:
            busy[0] = 0
            _send(caller, {"ended": _reason(status)})
        elif not (os.WIFEXITED(status) and os.WEXITSTATUS(status) == _RENEWED):
            return  # nobody is there to answer, or something else ended the child


def _reason(status: int) -> str:
    if not os.WIFSIGNALED(status):
        return f"exit code {os.WEXITSTATUS(status)}"
    number = os.WTERMSIG(status)
    return "time" if number == signal.SIGPROF else signal.Signals(number).name


def _work(caller: Connection, handle: Handle, busy: mmap.mmap) -> None:
    """Answer requests; never returns."""
    code = 1
    try:
        _limit_memory()
        for _ in range(_MOST_REQUESTS):
            request = json.loads(caller.recv_bytes())
            busy[0] = 1
            answer = _answer(handle, request)
            busy[0] = 0
            _send(caller, answer)
        code = _RENEWED
    except (EOFError, OSError):
        code = 0  # nobody is there to answer
    finally:
        os._exit(code)


def _answer(handle: Handle, request: dict[str, Any]) -> dict[str, Any]:
    # Time of the processor, so that a busy machine makes no difference; its signal ends the process where it stands.
    signal.setitimer(signal.ITIMER_PROF, request["limit_s"])
    try:
        return handle(request)
    except BaseException as error:  # noqa: BLE001 - the library may raise anything, and run out of memory
        return {"raised": f"{type(error).__name__}: {error}"[:500]}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _limit_memory() -> None:
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            taken = int(file.read().split()[0]) * resource.getpagesize()
    except OSError:
        return  # no Linux: the limit of time remains
    resource.setrlimit(resource.RLIMIT_AS, (taken + _MORE_BYTES, taken + _MORE_BYTES))


if __name__ == "__main__":
    main()
