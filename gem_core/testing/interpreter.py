"""Run a function in another Python process, which may hang or die without harm.

This module imports the standard library only, so that a check of what a plugin imports does not find it imported.
"""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from types import MappingProxyType
from typing import IO, Any

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from gem_core.testing.interpreter import serve; serve(int(sys.argv[2]))"
)
_NONE: Mapping[str, str] = MappingProxyType({})


class CallError(Exception):
    """The function in the other process raised; the message says what."""


class ProcessLostError(CallError):
    """The other process hung or ended.

    Args:
        message: How it ended.
        exit_code: None if it hung.
    """

    def __init__(self, message: str, exit_code: int | None) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def sent_by(
    function: Callable[..., None],
    *args: Any,
    variables: Mapping[str, str] = _NONE,
    stdout: IO[bytes] | int = subprocess.DEVNULL,
    stderr: IO[bytes] | int = subprocess.DEVNULL,
) -> Generator[Any]:
    """Call ``function(send, *args)`` in another process, and yield each value that it sends.

    The process has the ``sys.path`` of this one and another hash seed. It leads a session of its own: Ctrl-C in a
    terminal does not reach it, and what it starts is killed with it. It ends itself where ``allow`` says so, with its
    traceback on standard error.

    Args:
        function: Of a module that can be imported there.
        *args: Its further arguments.
        variables: Environment variables over those of this process.
        stdout: A file for its standard output, which is dropped otherwise.
        stderr: A file for its standard error, which is dropped otherwise.

    Raises:
        CallError: The function raised something.
        ProcessLostError: The process hung or ended.
    """
    ours, theirs = Pipe()
    hash_seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    path = json.dumps([entry or os.getcwd() for entry in sys.path])
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-u", "-c", _START, path, str(theirs.fileno())],
            env={**os.environ, "PYTHONHASHSEED": hash_seed, **variables},
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stderr,
            pass_fds=[theirs.fileno()],
            start_new_session=True,
        )
    limit_s, since = 0.0, time.monotonic()
    try:
        ours.send((function, args))
        while True:
            # Its child processes may keep the connection open after its end.
            while not ours.poll(0.1):
                if process.poll() is not None and not ours.poll(0.0):
                    raise EOFError
            what, value = ours.recv()
            if what == "limit":
                limit_s, since = value, time.monotonic()
            elif what == "sent":
                yield value
            elif what == "raised":
                raise CallError(f"it raised {value}")
            else:
                return
    except (EOFError, OSError):
        with suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
        if process.poll() == 1 and limit_s and time.monotonic() - since >= limit_s:
            raise ProcessLostError(f"it gave no answer within {limit_s:g} s", None) from None
        raise ProcessLostError(f"the process ended with exit code {process.poll()}", process.poll()) from None
    finally:
        ours.close()
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def serve(number: int) -> None:
    """Call the function that the other end of a socket asks for.

    Args:
        number: Of the open socket.
    """
    faulthandler.enable()
    connection = Connection(number)
    function, args = connection.recv()
    try:
        function(Sender(connection), *args)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code; the other side is told
        connection.send(("raised", f"{type(error).__name__}: {error}"))
    else:
        connection.send(("returned", None))


class Sender:
    """Sends values to the process that asked.

    Args:
        connection: To that process.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __call__(self, value: Any) -> None:
        """Send a value."""
        self._connection.send(("sent", value))

    def allow(self, limit_s: float) -> None:
        """End this process, with a traceback on standard error, unless called again within ``limit_s`` seconds."""
        self._connection.send(("limit", limit_s))
        faulthandler.dump_traceback_later(limit_s, exit=True)
