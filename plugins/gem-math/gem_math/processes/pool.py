"""``Pool``: has work done in processes that outlive hostile input: any of it may be ended where it stands.

The processes are shared by all threads of this one, are started when they are needed, and end with it.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import subprocess
import sys
import threading
import weakref
from itertools import count
from typing import Any

from gem_core.errors import GemError
from gem_math.processes.wire import SilenceError, WireError, receive, send

_START_S = 300.0
_SLACK_S = 60.0
"""Seconds of the clock, beside the limit on the processor's time: a net under it for a machine that is overloaded."""
_PATIENCE_S = 0.2
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
        self._numbers = count(1)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "gem_math.processes.worker", module],
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
            raise WireError(f"cannot be loaded ({greeting.get('failed')})")

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
        self._changed = threading.Condition()
        self._idle: list[_Worker] = []
        self._all: set[_Worker] = set()
        self._starting = 0

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
        try:
            answer = self._ask(request, limit_s)
        except SilenceError as error:
            raise self._error(f"{self._name} did not answer: {error}; is the machine overloaded?") from error
        except WireError:
            # Something else ended the process, and the idle ones perhaps: whoever asked did nothing wrong.
            with self._changed:
                idle, self._idle = self._idle, []
            for worker in idle:
                self._drop(worker)
            try:
                answer = self._ask(request, limit_s)
            except WireError as error:
                raise self._error(f"the process that runs {self._name} was ended twice: {error}") from error
        ended = answer.get("ended")
        if ended is not None:
            late = ended == "time"
            raise EndedError(f"it took more than {limit_s:g} s" if late else f"its process died ({ended})", late=late)
        return answer

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
            worker = _Worker(self._module)
        except BaseException as error:
            with self._changed:
                self._starting -= 1
                self._changed.notify_all()
            if isinstance(error, WireError):
                raise self._error(f"{self._name} {error}") from error
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
