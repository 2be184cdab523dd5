"""``Interpreter``: another Python process that calls functions for this one, and may hang or die without harm.

Requests and answers are pickles. This module imports the standard library only, so that a check of what a plugin
imports does not find it imported already.
"""

from __future__ import annotations

import faulthandler
import json
import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from types import MappingProxyType
from typing import IO, Any

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from gem_core.testing.interpreter import serve; serve(int(sys.argv[2]))"
)
_START_S = 60.0

_NONE: Mapping[str, str] = MappingProxyType({})


class CallError(Exception):
    """A remote call did not return; the message says why."""


class InterpreterLostError(CallError):
    """The interpreter hung or ended, and is gone.

    Args:
        message: How it ended.
        exit_code: None where it hung.
    """

    def __init__(self, message: str, exit_code: int | None) -> None:
        super().__init__(message)
        self.exit_code = exit_code


class Interpreter:
    """A Python process with the ``sys.path`` of this one and another hash seed.

    It leads a session of its own: Ctrl-C in a terminal does not reach it, and what it starts is killed with it.

    Args:
        variables: Environment variables over those of this process.
        stdout: A file for its standard output, which is dropped otherwise.
        stderr: A file for its standard error, which is dropped otherwise.
        stop: Makes every call fail once it is set, so that another thread can end the waiting.

    Raises:
        InterpreterLostError: It cannot be started.
    """

    def __init__(
        self,
        variables: Mapping[str, str] = _NONE,
        stdout: IO[bytes] | int = subprocess.DEVNULL,
        stderr: IO[bytes] | int = subprocess.DEVNULL,
        stop: threading.Event | None = None,
    ) -> None:
        self._stop = stop or threading.Event()
        self._connection, theirs = Pipe()
        hash_seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
        path = json.dumps([entry or os.getcwd() for entry in sys.path])
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-u", "-c", _START, path, str(theirs.fileno())],
                env={**os.environ, "PYTHONHASHSEED": hash_seed, **variables},
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=stderr,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self.close = weakref.finalize(self, _end, self._process, self._connection, os.getpid())
        """Kill it, and what it has started; the end of this process does so too."""
        self.call(bool, timeout_s=_START_S)  # wait until it answers

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether it can be asked; False in a fork of the process that started it."""
        return self._process.poll() is None

    def call(self, function: Callable[..., Any], *args: Any, timeout_s: float) -> Any:
        """Return ``function(kept, *args)``, called there; ``kept`` is a dictionary that lives as long as it does.

        Raises:
            CallError: The function raised something.
            InterpreterLostError: It gave no answer in time, or ended.
        """
        request = pickle.dumps((function, args))
        try:
            self._connection.send_bytes(request)
            self._wait(timeout_s)
            returned, value = self._connection.recv()
        except (EOFError, OSError):
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(1.0)
            code = self._process.poll()
            self.close()
            raise InterpreterLostError(f"the process ended with exit code {code}", code) from None
        if not returned:
            raise CallError(f"it raised {value}")
        return value

    def _wait(self, timeout_s: float) -> None:
        deadline = time.monotonic() + timeout_s
        while not self._connection.poll(0.1):
            # Its child processes may keep the connection open after its end.
            if not self.is_alive and not self._connection.poll(0.0):
                raise EOFError
            if time.monotonic() >= deadline or self._stop.is_set():
                self._process.send_signal(signal.SIGUSR1)  # it writes its traceback to standard error, and ends
                with suppress(subprocess.TimeoutExpired):
                    self._process.wait(1.0)
                self.close()
                raise InterpreterLostError(f"it gave no answer within {timeout_s:g} s", None)


def _end(process: subprocess.Popen[bytes], connection: Connection, started_by: int) -> None:
    connection.close()
    if os.getpid() == started_by:  # and not a fork of it
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def serve(number: int) -> None:
    """Call functions for the interpreter at the other end of a socket, until it is gone.

    Args:
        number: Of the open socket.
    """
    faulthandler.enable()
    faulthandler.register(signal.SIGUSR1, chain=True)
    connection = Connection(number)
    # In a thread, so that the end of the other side is noticed while a call hangs.
    threading.Thread(target=_end_with, args=(number,), daemon=True).start()
    kept: dict[str, Any] = {}
    while True:
        request = connection.recv_bytes()
        try:
            function, args = pickle.loads(request)
            answer = True, function(kept, *args)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code; the other side is told
            answer = False, f"{type(error).__name__}: {error}"
        connection.send(answer)


def _end_with(number: int) -> None:
    """Wait until the other side of a socket is closed, then kill this process and all that it has started."""
    poll = select.poll()
    poll.register(number, 0)  # no event but the end, which is always told
    poll.poll()
    os.killpg(0, signal.SIGKILL)
