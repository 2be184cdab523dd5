"""``ask``: has reasoning-gym do something, in a process that outlives hostile answers and slow generators.

The processes are shared by all environments of this process, are started when they are needed, and end with it.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import subprocess
import sys
import threading
from itertools import count
from typing import Any

from gem_core.errors import GemError, refuse_windows
from gem_math.reasoning.wire import SilenceError, WireError, receive, send

refuse_windows("rg:*")

_START_S = 300.0
_SLACK_S = 60.0
"""Seconds of the clock, beside the limit on the processor's time: a net under it for a machine that is overloaded."""
_PATIENCE_S = 0.2
_PASSED_ON = ("PATH", "HOME", "LANG", "TMPDIR", "SYSTEMROOT", "VIRTUAL_ENV", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH")
_FIXED = {"PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}


class LibraryError(GemError):
    """reasoning-gym, or the process that runs it, failed whatever the agent did."""


class EndedError(Exception):
    """The work was ended: it took too long or too much memory; the message says which."""


class _Worker:
    """One process that runs the library."""

    def __init__(self) -> None:
        passed = {name: value for name, value in os.environ.items() if name in _PASSED_ON or name.startswith("PYTHON")}
        self._numbers = count(1)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "gem_math.reasoning.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**passed, **_FIXED},
            start_new_session=True,
            bufsize=0,
        )
        try:
            greeting = receive(self._outgoing, _START_S) or {"failed": "its process ended at once"}
        except WireError as error:
            greeting = {"failed": str(error)}
        except BaseException:
            self.end()
            raise
        if "ready" not in greeting:
            self.end()
            raise LibraryError(f"reasoning-gym cannot be loaded ({greeting.get('failed')}): pip install gem-math")

    @property
    def _outgoing(self) -> int:
        return self._process.stdout.fileno() if self._process.stdout else -1

    def ask(self, request: dict[str, Any], limit_s: float) -> dict[str, Any]:
        """Return the answer to a request.

        Raises:
            WireError: The process does not answer, and has to be ended.
        """
        number = next(self._numbers)
        if self._process.stdin is None:
            raise WireError("it was ended")
        send(self._process.stdin.fileno(), {**request, "number": number, "limit_s": limit_s})
        answer = receive(self._outgoing, limit_s + _SLACK_S)
        if answer is None or answer.get("number") != number:
            raise WireError("its answer did not come")
        return answer

    def end(self) -> None:
        """End it and its child."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self.close()
        self._process.wait()

    def close(self) -> None:
        """Close the pipes, upon which it ends by itself."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


class _Pool:
    """The processes of this one: as many as work at a time, up to a limit; the last one that worked comes first."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._idle: list[_Worker] = []
        self._all: set[_Worker] = set()
        self._starting = 0
        self._most = max(1, min(4, os.cpu_count() or 1))

    def ask(self, request: dict[str, Any], limit_s: float) -> dict[str, Any]:
        try:
            return self._ask(request, limit_s)
        except SilenceError as error:
            raise LibraryError(f"reasoning-gym did not answer: {error}; is the machine overloaded?") from error
        except WireError:
            pass  # somebody ended the process; whoever asked did nothing wrong
        try:
            return self._ask(request, limit_s)
        except WireError as error:
            raise LibraryError(f"the process that runs reasoning-gym was ended twice: {error}") from error

    def _ask(self, request: dict[str, Any], limit_s: float) -> dict[str, Any]:
        worker = self._take()
        try:
            answer = worker.ask(request, limit_s)
        except BaseException:
            self._drop(worker)
            raise
        with self._changed:
            self._idle.append(worker)
            self._changed.notify()
        return answer

    def _count(self) -> int:
        return len(self._all) + self._starting

    def _take(self) -> _Worker:
        with self._changed:
            while not self._idle:
                # A second process takes seconds to start: only where the others are busy for some time.
                first = not self._count()
                freed = not first and self._changed.wait(_PATIENCE_S if self._count() < self._most else None)
                if not freed and not self._idle and self._count() < self._most:
                    self._starting += 1
                    break
            else:
                return self._idle.pop()
        try:
            worker = _Worker()
        except BaseException:
            with self._changed:
                self._starting -= 1
                self._changed.notify_all()
            raise
        with self._changed:
            self._starting -= 1
            self._all.add(worker)
        return worker

    def _drop(self, worker: _Worker) -> None:
        worker.end()
        with self._changed:
            self._all.discard(worker)
            self._changed.notify_all()

    def end(self) -> None:
        """End all processes."""
        with self._changed:
            workers, self._all, self._idle = self._all, set(), []
        for worker in workers:
            worker.end()

    def forget(self) -> None:
        """Close what a fork has copied: the processes are its parent's."""
        for worker in self._all:
            worker.close()


_pool = _Pool()


def ask(request: dict[str, Any], limit_s: float) -> dict[str, Any]:
    """Have the library do something; safe to call from several threads.

    Args:
        request: As ``catalogue.Catalogue.handle`` takes it.
        limit_s: Seconds of the processor's time after which the work is ended.

    Returns:
        What came of it. ``"raised"`` in it is what the library raised, and ``"wrong"`` what is wrong with the request.

    Raises:
        EndedError: It took more than the limit, or died.
        LibraryError: The library cannot be loaded, or its process is ended from outside, or gets no time.
    """
    answer = _pool.ask(request, limit_s)
    ended = answer.get("ended")
    if ended == "time":
        raise EndedError(f"it took more than {limit_s:g} s")
    if ended is not None:
        raise EndedError(f"its process died ({ended})")
    return answer


def end_processes() -> None:
    """End the processes; the next call of ``ask`` starts new ones."""
    _pool.end()


def _after_fork() -> None:
    global _pool
    _pool.forget()
    _pool = _Pool()


atexit.register(end_processes)
os.register_at_fork(after_in_child=_after_fork)
