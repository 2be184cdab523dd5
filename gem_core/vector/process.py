"""``ProcessWorker``: a worker in a process of this machine."""

from __future__ import annotations

import atexit
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
import weakref
from contextlib import suppress
from multiprocessing.connection import Connection

from gem_core.closing import CLOSING_S
from gem_core.errors import ArgumentError
from gem_core.vector.remote import Worker, WorkerDiedError, WorkerPool
from gem_core.vector.setup import VectorSetup

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from gem_core.vector.worker import main; main(int(sys.argv[2]))"
)

_COMMAND_S = 1.0
"""Seconds that a worker may take to notice that the program hangs up."""

_LOOKING_S = 0.5
"""Seconds between two checks that the process lives while a thread waits for its reply.

Its children may hold the socket open."""

_workers: weakref.WeakSet[ProcessWorker] = weakref.WeakSet()


def process_pool(setup: VectorSetup, *, workers: int | None) -> WorkerPool:
    """Return workers in processes of this machine; see ``backends.processes``.

    Raises:
        ArgumentError: The number is out of range, or the setup cannot be sent to another process.
    """
    if workers is not None and (type(workers) is not int or workers < 1):
        raise ArgumentError(f"workers must be a positive whole number, not {workers!r}")
    return WorkerPool(setup, ProcessWorker, min(len(setup.slots), workers or _cores()))


class ProcessWorker(Worker):
    """A worker process.

    It is started as a separate program, never forked: it inherits no threads and locks, and a script needs no
    ``if __name__ == "__main__"``. It leads a session, so that Ctrl-C in a terminal does not reach it, and the processes
    that it started can be killed with it. It ends by itself when this process hangs up, or ends.

    Args:
        packed: Pickled ``VectorSetup``.

    Raises:
        GemError: The setup cannot be used there.
        WorkerDiedError: It ended at its start.
    """

    def __init__(self, packed: bytes) -> None:
        ours, theirs = socket.socketpair()
        path = json.dumps([entry or os.getcwd() for entry in sys.path])
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _START, path, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        self._connection = Connection(ours.detach())
        # When a vector environment is garbage-collected, its workers close their environments, and end by themselves.
        self._ended = weakref.finalize(self, _hang_up, self._connection, self._process, os.getpid())
        self._ended.atexit = False  # see _close_all
        self.started_by = os.getpid()
        _workers.add(self)
        problem = pickle.loads(self.request(packed, None))
        if problem is not None:
            self.kill()
            raise problem

    def request(self, data: bytes, timeout_s: float | None) -> bytes:
        """Send a request, and wait for the reply."""
        end = None if timeout_s is None else time.monotonic() + timeout_s
        try:
            self._connection.send_bytes(data)
            while True:
                left = _LOOKING_S if end is None else min(_LOOKING_S, max(0.0, end - time.monotonic()))
                if self._connection.poll(left):
                    return self._connection.recv_bytes()
                if end is not None and time.monotonic() >= end:
                    raise TimeoutError
                if self._process.poll() is not None and not self._connection.poll(0):
                    raise EOFError
        except TimeoutError:
            raise
        except (EOFError, OSError):
            raise WorkerDiedError(self._death()) from None

    def is_alive(self) -> bool:
        """Tell whether the process has not ended."""
        return self._process.poll() is None

    def kill(self) -> None:
        """Kill the worker, and all processes that it has started."""
        if not self._ended.alive:
            return
        self._ended()
        _kill_group(self._process.pid)
        self._process.wait()
        self._connection.close()

    def hang_up(self) -> None:
        """Let the worker close its environments and end, without waiting for it."""
        _shut(self._connection)

    def finish(self, since: float) -> None:
        """Wait for the end of a worker whose connection was shut at a time; kill it if that takes too long."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(max(0.0, since + _COMMAND_S + CLOSING_S - time.monotonic()))
        self.kill()

    def _death(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_COMMAND_S)
        code = self._process.poll()
        if code is not None and code < 0:
            try:
                return f"was killed by {signal.Signals(-code).name}"
            except ValueError:
                return f"was killed by signal {-code}"
        return f"ended with exit code {code}"


@atexit.register
def _close_all() -> None:
    """At the end of the program, let all workers close their environments, and wait for their end."""
    workers = [worker for worker in _workers if worker.started_by == os.getpid()]
    since = time.monotonic()
    try:
        for worker in workers:
            worker.hang_up()
        for worker in workers:
            worker.finish(since)
    finally:
        for worker in workers:
            worker.kill()


def _hang_up(connection: Connection, process: subprocess.Popen[bytes], started_by: int) -> None:
    if os.getpid() == started_by:  # not in a fork, which has only copies
        _shut(connection)
        with suppress(RuntimeError):  # the interpreter is ending
            threading.Thread(target=process.wait, name="gem-reap", daemon=True).start()


def _shut(connection: Connection) -> None:
    """Shut a connection down, so that both sides read its end."""
    try:
        with socket.socket(fileno=os.dup(connection.fileno())) as plug:
            plug.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # already closed


def _kill_group(leader: int) -> None:
    try:
        os.killpg(leader, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return  # all processes of the group have ended


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
