"""The backend ``process``: environments in worker processes, many in each."""

from __future__ import annotations

import atexit
import json
import os
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

from gem_core.errors import ArgumentError
from gem_core.vector.remote import Link, Message, RemoteHost, weakly, worker_setup
from gem_core.vector.setup import VectorSetup
from gem_core.vector.wire import Outbox, from_bytes
from gem_core.vector.worker import SharedTimes

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from gem_core.vector.worker import main; main(*map(int, sys.argv[2:]))"
)

_CLOSING_S = 6.0
"""How long a worker may take to end by itself; a little longer than it gives its environments."""

_COMMAND_S = 1.0
"""How long it may take to finish the command that it is in, before that."""


def process_host(setup: VectorSetup, *, workers: int | None, worker_memory_bytes: int | None) -> RemoteHost:
    """Return a host whose workers are processes of this machine; see ``backends.processes``.

    Raises:
        ArgumentError: A number that cannot be.
    """
    for name, value in (("workers", workers), ("worker_memory_bytes", worker_memory_bytes)):
        if value is not None and (type(value) is not int or value < 1):
            raise ArgumentError(f"{name} must be a positive whole number, not {value!r}")
    count = min(len(setup.ids), workers or _cores())
    blob = worker_setup(setup, {"worker_memory_bytes": worker_memory_bytes})
    return RemoteHost(setup, lambda told, died: ProcessLink(blob, len(setup.ids), told, died), count)


class ProcessLink(Link):
    """A worker process.

    It is started as a program of its own, never forked: the threads and locks of this process are none of its matter,
    and a script needs no ``if __name__ == "__main__"``. It leads a session, so that Ctrl-C in a terminal does not reach
    it, and what it has started can be killed with it.

    Args:
        setup: What its environments are made from.
        slots: Number of slots.
        on_messages: See ``Link``.
        on_death: See ``Link``.
    """

    def __init__(
        self,
        setup: bytes,
        slots: int,
        on_messages: Callable[[Link, list[Message]], None],
        on_death: Callable[[Link], None],
    ) -> None:
        ours, theirs = socket.socketpair()
        lifeline, held = os.pipe()
        with theirs, tempfile.TemporaryFile() as times:
            times.truncate(max(8, 8 * slots))
            self._times = SharedTimes(times.fileno(), slots)
            numbers = theirs.fileno(), lifeline, times.fileno()
            path = json.dumps([entry or os.getcwd() for entry in sys.path])
            try:
                self._process = subprocess.Popen(
                    [sys.executable, "-c", _START, path, *map(str, numbers)],
                    pass_fds=numbers,
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,
                )
            finally:
                os.close(lifeline)
        self._connection = Connection(ours.detach())
        # A vector environment that nobody uses any more lets go of its workers, which then end by themselves.
        self._ended = weakref.finalize(self, _let_go, self._connection, held, os.getpid())
        self._ended.atexit = False  # see _close_all
        self._outbox = Outbox(self._connection.send_bytes, setup)
        target = weakly(on_messages), weakly(on_death)
        reading = threading.Thread(
            target=_read, args=(weakref.ref(self), self._connection, *target), name="gem-worker", daemon=True
        )
        reading.start()
        threading.Thread(
            target=_reap, args=(self._process, self._connection, reading, self._outbox), name="gem-reap", daemon=True
        ).start()
        self.started_by = os.getpid()
        _links.add(self)

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def send(self, messages: list[Message]) -> None:
        """Hand messages to the worker without waiting for it."""
        for message in messages:
            self._outbox.put(message)

    def running(self) -> dict[int, float]:
        """Return the slots whose command runs, or ran when it died, and since when."""
        return self._times.present()

    def death(self) -> str:
        """Say how it died."""
        code = self._process.poll()
        if code is not None and code < 0:
            try:
                return f"was killed by {signal.Signals(-code).name}"
            except ValueError:
                return f"was killed by signal {-code}"
        return f"ended with exit code {code}"

    def kill(self) -> None:
        """End the worker at once, and all that it has started."""
        if self._process.poll() is None:
            _kill_group(self._process.pid)
            self._process.wait()
        self._ended()

    def close(self) -> None:
        """Let the worker close its environments, and end it."""
        self.hang_up()
        self.finish(time.monotonic())

    def hang_up(self) -> None:
        """Let the worker close its environments, without waiting for it."""
        shut(self._connection)

    def finish(self, since: float) -> None:
        """Wait for the end of a worker that was hung up on at a time, and kill it if that takes too long."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(since + _COMMAND_S - time.monotonic())
        if not self.running():
            # It has taken note, and closes what it has; one that still computes would not come to it.
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(since + _CLOSING_S - time.monotonic())
        self.kill()


_links: weakref.WeakSet[ProcessLink] = weakref.WeakSet()


@atexit.register
def _close_all() -> None:
    """Let the workers of a program that ends close what they have; none of them is left behind."""
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
    """Hang up, so that both sides read the end of it."""
    try:
        with socket.socket(fileno=os.dup(connection.fileno())) as plug:
            plug.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # it is closed already


def _read(
    link_of: weakref.ref[ProcessLink],
    connection: Connection,
    on_messages: Callable[[], Callable[[Link, list[Message]], None] | None],
    on_death: Callable[[], Callable[[Link], None] | None],
) -> None:
    while True:
        try:
            messages = from_bytes(connection.recv_bytes())
        except (EOFError, OSError):
            break
        link, told = link_of(), on_messages()
        if link is None or told is None:
            return
        told(link, messages)
        del link, told, messages
    link, died = link_of(), on_death()
    if link is not None and died is not None:
        link._process.wait()
        died(link)


def _reap(process: subprocess.Popen[bytes], connection: Connection, reading: threading.Thread, outbox: Outbox) -> None:
    """Take note of the end of a worker; what it left behind may hold its connection open, and must not."""
    process.wait()
    _kill_group(process.pid)
    reading.join(1.0)
    shut(connection)
    outbox.close()
    reading.join()
    connection.close()


def _let_go(connection: Connection, lifeline: int, started_by: int) -> None:
    if os.getpid() == started_by:  # and not a fork of it, which has but a copy
        shut(connection)
    os.close(lifeline)


def _kill_group(leader: int) -> None:
    try:
        os.killpg(leader, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return  # nobody is left


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
