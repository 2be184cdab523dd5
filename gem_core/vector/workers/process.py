"""The backend ``process``: environments in worker processes, many in each."""

from __future__ import annotations

import atexit
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.vector.executor import CommandTimes
from gem_core.vector.setup import VectorSetup
from gem_core.vector.workers.remote import RemoteExecutor, Running, WorkerLink

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from gem_core.vector.workers.worker import main; main(*map(int, sys.argv[2:]))"
)

_CLOSING_S = 6.0
"""Seconds that a worker may take to end by itself; a little longer than it gives its environments."""

_COMMAND_S = 1.0
"""Seconds that it may take before that to finish its present command."""


class ProcessExecutor(RemoteExecutor):
    """Runs environments in processes of this machine; see ``backends.processes``.

    Args:
        setup: What environments are made from.
        workers: Number of processes; None for one for each core.
        worker_memory_bytes: Address space that each may use; None for no limit.

    Raises:
        ArgumentError: A number is out of range.
    """

    def __init__(self, setup: VectorSetup, *, workers: int | None, worker_memory_bytes: int | None) -> None:
        for name, value in (("workers", workers), ("worker_memory_bytes", worker_memory_bytes)):
            if value is not None and (type(value) is not int or value < 1):
                raise ArgumentError(f"{name} must be a positive whole number, not {value!r}")
        super().__init__(setup, min(len(setup.ids), workers or _cores()))
        self.worker_memory_bytes = worker_memory_bytes

    def start_worker(self) -> ProcessLink:
        """Start a process."""
        return ProcessLink(self)


class ProcessLink(WorkerLink):
    """A worker process.

    It is started as a separate program, never forked: it inherits no threads and locks, and a script needs no
    ``if __name__ == "__main__"``. It leads a session, so that Ctrl-C in a terminal does not reach it, and the processes
    that it started can be killed with it.

    It has three threads in this process. One reads; one writes, since a busy worker does not read and the caller must
    not wait for it; one waits for the end of the process, since its children may keep the connection open.

    Args:
        executor: Executor that the worker belongs to.
    """

    def __init__(self, executor: ProcessExecutor) -> None:
        super().__init__(executor)
        ours, theirs = socket.socketpair()
        lifeline, held = os.pipe()
        with theirs, tempfile.TemporaryFile() as times:
            self._times = CommandTimes(len(executor.setup.ids), times.fileno())
            files = theirs.fileno(), lifeline, times.fileno()
            path = json.dumps([entry or os.getcwd() for entry in sys.path])
            arguments = *files, executor.worker_memory_bytes or 0
            try:
                self._process = subprocess.Popen(
                    [sys.executable, "-c", _START, path, *map(str, arguments)],
                    pass_fds=files,
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,
                )
            finally:
                os.close(lifeline)
        self._connection = Connection(ours.detach())
        # When a vector environment is garbage-collected, the connections close, and its workers end by themselves.
        self._ended = weakref.finalize(self, _let_go, self._connection, held, os.getpid())
        self._ended.atexit = False  # see _close_all
        self._outbox: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._outbox.put(executor.packed)
        reading = _thread("gem-worker", _read, weakref.ref(self), self._connection)
        _thread("gem-outbox", _write, self._outbox, self._connection)
        _thread("gem-reap", _reap, self._process, self._connection, reading, self._outbox)
        self.started_by = os.getpid()
        _links.add(self)

    def send(self, data: bytes) -> None:
        """Send bytes to the worker without waiting for it."""
        self._outbox.put(data)

    def running(self) -> Running:
        """Return the commands that are running, or were running when it died."""
        return Running(time.monotonic(), self._times.running())

    def wait(self) -> None:
        """Wait for the end of the process."""
        self._process.wait()

    def death(self) -> str:
        """Return how it died, as part of a sentence."""
        code = self._process.poll()
        if code is not None and code < 0:
            try:
                return f"was killed by {signal.Signals(-code).name}"
            except ValueError:
                return f"was killed by signal {-code}"
        return f"ended with exit code {code}"

    def kill(self) -> None:
        """Kill the worker, and all processes that it has started."""
        if self._process.poll() is None:
            _kill_group(self._process.pid)
            self._process.wait()
        self._ended()

    def close(self) -> None:
        """Let the worker close its environments, then end it."""
        self.hang_up()
        self.finish(time.monotonic())

    def hang_up(self) -> None:
        """Let the worker close its environments, without waiting for it."""
        shut(self._connection)

    def finish(self, since: float) -> None:
        """Wait for the end of a worker whose connection was closed at ``since``; kill it if that takes too long."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(since + _COMMAND_S - time.monotonic())
        if not self._times.running():
            # It has noticed, and is closing its environments; a worker that still computes would not get there.
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(since + _CLOSING_S - time.monotonic())
        self.kill()


_links: weakref.WeakSet[ProcessLink] = weakref.WeakSet()


@atexit.register
def _close_all() -> None:
    """At the end of the program, let all workers close their environments, and wait for their end."""
    links = [link for link in _links if link.started_by == os.getpid()]
    since = time.monotonic()
    try:
        for link in links:
            link.hang_up()
        for link in links:
            link.finish(since)
    finally:
        for link in links:
            link.kill()


def shut(connection: Connection) -> None:
    """Shut a connection down, so that both sides read its end."""
    try:
        with socket.socket(fileno=os.dup(connection.fileno())) as plug:
            plug.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # already closed


def _thread(name: str, target: Callable[..., None], *args: Any) -> threading.Thread:
    thread = threading.Thread(target=target, args=args, name=name, daemon=True)
    thread.start()
    return thread


def _read(link_of: weakref.ref[ProcessLink], connection: Connection) -> None:
    while True:
        try:
            data = connection.recv_bytes()
        except (EOFError, OSError):
            break
        link = link_of()
        if link is None:
            return
        link.received(data)
        del link, data
    link = link_of()
    if link is not None:
        link.wait()
        link.died()


def _write(outbox: queue.SimpleQueue[bytes | None], connection: Connection) -> None:
    with suppress(OSError):  # the reading thread notices that the worker is gone
        while (data := outbox.get()) is not None:
            connection.send_bytes(data)


def _reap(
    process: subprocess.Popen[bytes],
    connection: Connection,
    reading: threading.Thread,
    outbox: queue.SimpleQueue[bytes | None],
) -> None:
    """Wait for the end of a worker; kill its remaining children, which may keep its connection open."""
    process.wait()
    _kill_group(process.pid)
    reading.join(1.0)
    shut(connection)
    outbox.put(None)
    reading.join()
    connection.close()


def _let_go(connection: Connection, lifeline: int, started_by: int) -> None:
    if os.getpid() == started_by:  # not in a fork, which has only copies
        shut(connection)
    os.close(lifeline)


def _kill_group(leader: int) -> None:
    try:
        os.killpg(leader, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return  # all processes of the group have ended


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
