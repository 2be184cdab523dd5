"""``Pool``: has work done in processes that outlive hostile input: any of it may be ended where it stands.

Threads share the processes, which are started when they are needed. ``concurrent.futures`` and ``pebble`` would run the
user's script again unless it guards itself by ``__name__``, or fork a process that has threads; and their limits are of
the clock, so that a right answer would be wrong on a busy machine.

A process of the pool imports what it needs and forks a child, which works under limits that the kernel holds: seconds
of the processor, and memory. If the child is ended, its parent says so and forks the next: nothing is imported again.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import json
import mmap
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection, Pipe
from typing import Any

from gem_core.errors import GemError

_START_S = 300.0
_SLACK_S = 60.0
"""Seconds of the clock, beside the limit on the processor's time: a net under it for a machine that is overloaded."""
_MORE_BYTES = 1 << 30
"""Memory that a child may take on top of what it begins with."""
_MOST_REQUESTS, _RENEWED = 5000, 3
"""After so many requests a child makes room for a fresh one, since libraries have caches that grow; its exit code."""
FIXED = {"PYTHONHASHSEED": "0", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
"""Set in the environment of the processes, so that the same is computed everywhere."""


class EndedError(Exception):
    """The work was ended; the message says whether it took too long or too much memory."""


class _Worker:
    """One process, that serves a module."""

    def __init__(self, module: str) -> None:
        self._connection, theirs = Pipe()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "gem_math.processes", module, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,  # libraries print
                stderr=subprocess.DEVNULL,
                env=os.environ | FIXED,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )

    def receive(self, timeout_s: float) -> dict[str, Any]:
        """Return its next message, which is JSON: unpickling would run what a hostile answer makes of it.

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
        self._connection.send((request, limit_s))
        return self.receive(limit_s + _SLACK_S)

    def end(self) -> None:
        """End it and its child."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.close()
        self.process.wait()

    def close(self) -> None:
        """Close the connection, upon which it ends by itself."""
        with contextlib.suppress(OSError):
            self._connection.close()


class Pool:
    """As many processes as work at a time, up to a limit; the last one that worked comes first.

    Args:
        module: What the processes serve: its ``load()`` is called once, ``guard()`` when a child begins to work, and
            ``handle(request)`` for each request.
        name: What does the work, for errors.
        error: The type of errors.
        most: The limit.
    """

    def __init__(self, module: str, name: str, error: type[GemError], most: int) -> None:
        self._module, self._name, self._error, self._most = module, name, error, most
        self.idle: list[_Worker] = []
        self._after_fork()
        atexit.register(self.end)
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._after_fork)

    def _after_fork(self) -> None:
        """Begin without processes: those that a fork has copied are the parent's."""
        for worker in self.idle:
            worker.close()
        self.idle = []
        self._slots = threading.Semaphore(self._most)

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
                answer = self._asked(self.idle.pop() if self.idle else self._start(), request, limit_s)
            except (EOFError, ConnectionError):
                # Something else ended the process: whoever asked did nothing wrong.
                try:
                    answer = self._asked(self._start(), request, limit_s)
                except (EOFError, ConnectionError) as error:
                    raise self._error(f"the process that runs {self._name} was ended twice") from error
        if answer.get("ended") == "SIGPROF":
            raise EndedError(f"it took more than {limit_s:g} s")
        if "ended" in answer:
            raise EndedError(f"its process died ({answer['ended']})")
        return answer

    def _asked(self, worker: _Worker, request: dict[str, Any], limit_s: float) -> dict[str, Any]:
        """Return a worker's answer, after which it is idle; end it if none comes."""
        try:
            answer = worker.ask(request, limit_s)
        except BaseException as error:
            worker.end()
            if isinstance(error, TimeoutError):
                message = f"{self._name} did not answer: {error}; is the machine overloaded?"
                raise self._error(message) from error
            raise
        self.idle.append(worker)
        return answer

    def _start(self) -> _Worker:
        worker = _Worker(self._module)
        try:
            failed = worker.receive(_START_S).get("failed")
        except (EOFError, OSError) as error:
            failed = str(error) or "its process ended at once"
        except BaseException:
            worker.end()
            raise
        if failed:
            worker.end()
            raise self._error(f"{self._name} cannot be loaded ({failed})")
        return worker

    def end(self) -> None:
        """End the idle processes; the others end by themselves when their caller does."""
        while self.idle:
            self.idle.pop().end()


def _serve(module_name: str, caller: Connection) -> None:
    """Have one child after another work until the connection is closed, and answer in place of those that are ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        module = importlib.import_module(module_name)
        module.load()
    except Exception as error:  # noqa: BLE001 - whatever keeps a library from loading is told
        _send(caller, {"failed": f"{type(error).__name__}: {error}"})
        return
    _send(caller, {})
    gc.collect()
    gc.freeze()
    busy = mmap.mmap(-1, 1)  # shared with the child: whether it has a request in hand
    while True:
        child = os.fork()
        if child == 0:
            _work(module, caller, busy)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if busy[0]:
            busy[0] = 0
            _send(caller, {"ended": signal.Signals(-code).name if code < 0 else f"exit code {code}"})
        elif code != _RENEWED:
            return  # nobody is there to answer, or something else ended the child


def _work(module: Any, caller: Connection, busy: mmap.mmap) -> None:
    """Answer requests; never returns."""
    code = 1
    try:
        _limit_memory()
        module.guard()
        for _ in range(_MOST_REQUESTS):
            request, limit_s = caller.recv()
            busy[0] = 1
            answer = _answer(module.handle, request, limit_s)
            busy[0] = 0
            _send(caller, answer)
        code = _RENEWED
    except (EOFError, OSError):
        code = 0  # nobody is there to answer
    finally:
        os._exit(code)


def _answer(handle: Callable[[dict[str, Any]], dict[str, Any]], request: dict[str, Any], limit_s: float) -> Any:
    # Time of the processor, so that a busy machine makes no difference; its signal ends the process where it stands.
    signal.setitimer(signal.ITIMER_PROF, limit_s)
    try:
        return handle(request)
    except BaseException as error:  # noqa: BLE001 - the library may raise anything, and run out of memory
        return {"raised": f"{type(error).__name__}: {error}"[:500]}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _send(caller: Connection, message: dict[str, Any]) -> None:
    caller.send_bytes(json.dumps(message).encode("ascii"))


def _limit_memory() -> None:
    import resource  # which Windows lacks

    with contextlib.suppress(OSError), open("/proc/self/statm", encoding="ascii") as file:  # Linux
        taken = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (taken + _MORE_BYTES, taken + _MORE_BYTES))


if __name__ == "__main__":
    _serve(sys.argv[1], Connection(int(sys.argv[2])))
