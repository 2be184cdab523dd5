"""``Pool``: has work done in processes that outlive hostile input: any of it may be ended where it stands.

The processes are shared by all threads of this one, are started when they are needed, and end with it. They are not
those of ``concurrent.futures``, which run the user's script again unless it guards itself by ``__name__``, or copy a
process that has threads.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import weakref
from multiprocessing.connection import Pipe
from typing import Any

from gem_core.errors import GemError

_START_S = 300.0
_SLACK_S = 60.0
"""Seconds of the clock, beside the limit on the processor's time: a net under it for a machine that is overloaded."""
_PASSED_ON = ("PATH", "HOME", "LANG", "TMPDIR", "SYSTEMROOT", "VIRTUAL_ENV", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH")
_FIXED = {"PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}


class EndedError(Exception):
    """The work was ended; the message says whether it took too long or too much memory.

    Args:
        message: The reason.
        late: Whether it took too long.
    """

    def __init__(self, message: str, *, late: bool = False) -> None:
        super().__init__(message)
        self.late = late


class _Worker:
    """One process; it serves what ``load()`` of a module returns."""

    def __init__(self, module: str) -> None:
        passed = {name: value for name, value in os.environ.items() if name in _PASSED_ON or name.startswith("PYTHON")}
        self._connection, theirs = Pipe()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "gem_math.processes.worker", module, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,  # libraries print
                stderr=subprocess.DEVNULL,
                env={**passed, **_FIXED},
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )

    def receive(self, timeout_s: float) -> dict[str, Any]:
        """Return its next message.

        Raises:
            TimeoutError: Nothing came in time.
            EOFError, OSError: It is gone.
        """
        if not self._connection.poll(timeout_s):
            raise TimeoutError(f"nothing came within {timeout_s:g} s")
        message: dict[str, Any] = json.loads(self._connection.recv_bytes())
        return message

    def ask(self, request: dict[str, Any], limit_s: float) -> dict[str, Any]:
        """Return the answer to a request; raise what ``receive`` raises."""
        # ASCII only: text of a model may hold lone surrogates, which UTF-8 cannot.
        self._connection.send_bytes(json.dumps({**request, "limit_s": limit_s}).encode("ascii"))
        return self.receive(limit_s + _SLACK_S)

    def end(self) -> None:
        """End it and its child."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self.close()
        self._process.wait()

    def close(self) -> None:
        """Close the connection, upon which it ends by itself."""
        with contextlib.suppress(OSError):
            self._connection.close()


class Pool:
    """As many processes as work at a time, up to a limit; the last one that worked comes first.

    Args:
        module: What the processes serve: its function ``load()`` returns one that answers a request.
        name: What does the work, for errors.
        error: The type of errors.
        most: The limit.
    """

    def __init__(self, module: str, name: str, error: type[GemError], most: int) -> None:
        self._module, self._name, self._error, self._most = module, name, error, most
        self._forget()
        _pools.add(self)

    def _forget(self) -> None:
        """Begin without processes: after a fork they are the parent's."""
        self._slots = threading.Semaphore(self._most)
        self._idle: list[_Worker] = []
        self._all: set[_Worker] = set()

    def ask(self, request: dict[str, Any], limit_s: float) -> dict[str, Any]:
        """Return the answer to a request; safe to call from several threads.

        Args:
            request: What the module takes.
            limit_s: Seconds of the processor's time after which the work is ended.

        Returns:
            What the module returned; ``"raised"`` in it is the error that it raised.

        Raises:
            EndedError: It took more than the limit, or died.
            GemError: Of the pool's type: a process cannot be started, is ended from outside, or gets no time.
        """
        with self._slots:
            try:
                answer = self._asked(self._take(), request, limit_s)
            except (EOFError, ConnectionError):
                # Something else ended the process: whoever asked did nothing wrong.
                try:
                    answer = self._asked(self._start(), request, limit_s)
                except (EOFError, ConnectionError) as error:
                    raise self._error(f"the process that runs {self._name} was ended twice") from error
        ended = answer.get("ended")
        if ended is not None:
            late = ended == "time"
            raise EndedError(f"it took more than {limit_s:g} s" if late else f"its process died ({ended})", late=late)
        return answer

    def _asked(self, worker: _Worker, request: dict[str, Any], limit_s: float) -> dict[str, Any]:
        """Return a worker's answer, after which it is idle; end it if none comes."""
        try:
            answer = worker.ask(request, limit_s)
        except BaseException as error:
            self._drop(worker)
            if isinstance(error, TimeoutError):
                message = f"{self._name} did not answer: {error}; is the machine overloaded?"
                raise self._error(message) from error
            raise
        self._idle.append(worker)
        return answer

    def _take(self) -> _Worker:
        try:
            return self._idle.pop()
        except IndexError:
            return self._start()

    def _start(self) -> _Worker:
        worker = _Worker(self._module)
        self._all.add(worker)
        try:
            failed = worker.receive(_START_S).get("failed")
        except (EOFError, OSError) as error:
            failed = str(error) or "its process ended at once"
        except BaseException:
            self._drop(worker)
            raise
        if failed:
            self._drop(worker)
            raise self._error(f"{self._name} cannot be loaded ({failed})")
        return worker

    def _drop(self, worker: _Worker) -> None:
        worker.end()
        self._all.discard(worker)

    def end(self) -> None:
        """End all processes."""
        self._idle.clear()
        for worker in list(self._all):
            self._drop(worker)

    def after_fork(self) -> None:
        """Close what a fork has copied, and begin anew."""
        for worker in self._all:
            worker.close()
        self._forget()


_pools: weakref.WeakSet[Pool] = weakref.WeakSet()


def _end_all() -> None:
    for pool in _pools:
        pool.end()


def _after_fork() -> None:
    for pool in _pools:
        pool.after_fork()


atexit.register(_end_all)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
