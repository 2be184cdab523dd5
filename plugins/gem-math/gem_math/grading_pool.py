"""Keeps warm processes that compare formulas by math-verify, and ends those that take too long.

No signal and no thread is needed for that, so it holds in any thread of any process: a caller waits for the reply of
its process as long as the limit says, kills it then, and another one takes its place.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import select
import subprocess
import sys
import threading
import time
from typing import Any, NamedTuple

from gem_core.errors import GradingError

_TICKS_PER_S = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100
_START_LIMIT_S = 120.0
# On a machine that is short of processors, a process that got less than half of its time is waited for longer.
_MAX_STRETCH = 4
_MAX_USES = 5000  # sympy's caches grow; a process is replaced now and then


class Verdict(NamedTuple):
    """What math-verify says.

    Args:
        same: Whether the formulas are the same.
        reason: Why there is none, where one of the two cannot be read or takes too long.
        late: Whether that is because the time was up.
        took_s: Seconds from the question to the reply.
    """

    same: bool
    reason: str = ""
    late: bool = False
    took_s: float = 0.0


class _Deadline:
    """When the time of a process is up."""

    def __init__(self, pid: int, timeout_s: float) -> None:
        self.pid = pid
        self.timeout_s = timeout_s
        self.started = time.monotonic()
        self.end = self.started + timeout_s
        self.last = self.started + timeout_s * _MAX_STRETCH
        self.cpu_started = _cpu_s(pid)

    def left_s(self) -> float:
        """Return the seconds left; more than the limit says where the process had no processor to run on."""
        now = time.monotonic()
        if self.end <= now < self.last and self.cpu_started is not None:
            cpu = _cpu_s(self.pid)
            used = self.timeout_s if cpu is None else cpu - self.cpu_started
            if used < self.timeout_s / 2:
                self.end = min(self.last, now + self.timeout_s - used)
        return self.end - now


def _cpu_s(pid: int) -> float | None:
    """Return the processor time that a process has used; None where the system does not tell."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            fields = file.read().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S


class _Worker:
    """One process."""

    def __init__(self) -> None:
        environment = {**os.environ, "PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-B", "-m", "gem_math.grading_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            bufsize=0,
            # Ctrl-C at a terminal goes to its whole process group; these end with their input.
            process_group=0 if os.name == "posix" else None,
        )
        self.buffer = b""
        self.uses = 0
        self.ready = False

    def await_start(self) -> None:
        """Wait until it has loaded what it needs, which takes about a second."""
        if self.ready:
            return
        self.ready = self.reply(_Deadline(self.process.pid, _START_LIMIT_S)) == "ready"
        if not self.ready:
            self.end()
            raise GradingError(
                "the process that compares formulas does not start. Run 'python -m gem_math.grading_worker' to see why"
            )

    def compare(self, gold: str, answer: str, timeout_s: float) -> Verdict:
        """Return the verdict; the process is dead afterwards if it failed to give one in time."""
        self.uses += 1
        deadline = _Deadline(self.process.pid, timeout_s)
        request = json.dumps({"gold": gold, "answer": answer, "cpu_s": timeout_s}) + "\n"
        try:
            self.send(request.encode())
            reply = self.reply(deadline)
        except BaseException:
            # An interrupted caller leaves no half-read reply to the next.
            self.end()
            raise
        if not isinstance(reply, dict):
            late = deadline.left_s() <= 0
            self.end()
            reason = "it takes more memory or processor time than a comparison may"
            return Verdict(same=False, reason=reason, late=late)
        if "failed" in reply:
            return Verdict(same=False, reason=reply["failed"])
        return Verdict(same=reply["same"])

    def send(self, request: bytes) -> None:
        stream = self.process.stdin
        with contextlib.suppress(BrokenPipeError):  # the reply will say so
            if stream is not None:
                stream.write(request)

    def reply(self, deadline: _Deadline) -> Any:
        """Return the next reply; None when there is none before the deadline, or the process died."""
        if self.process.stdout is None:
            return None
        descriptor = self.process.stdout.fileno()
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        while b"\n" not in self.buffer:
            remaining = deadline.left_s()
            if remaining <= 0:
                return None
            if not poll.poll(remaining * 1000):
                continue
            received = os.read(descriptor, 65536)
            if not received:
                return None
            self.buffer += received
        line, _, self.buffer = self.buffer.partition(b"\n")
        return json.loads(line)

    def end(self) -> None:
        """Kill the process and wait for it."""
        with contextlib.suppress(OSError):
            self.process.kill()
        self.process.wait()
        self.release()

    def release(self) -> None:
        """Close the pipes."""
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()


class Pool:
    """As many processes as there are cores, each started when it is first needed."""

    def __init__(self, size: int | None = None) -> None:
        self.size = size or _cores()
        self.free: list[_Worker] = []
        self.all: set[_Worker] = set()
        self.taken: dict[int, _Worker] = {}
        self.changed = threading.Condition()

    def compare(self, gold: str, answer: str, timeout_s: float) -> Verdict:
        """Compare two formulas by math-verify.

        Args:
            gold: LaTeX.
            answer: LaTeX.
            timeout_s: Limit in seconds, from the moment that a process takes it up.

        Raises:
            GradingError: The process cannot be started.
        """
        try:
            worker = self._take()
            worker.await_start()
            started = time.monotonic()
            verdict = worker.compare(gold, answer, timeout_s)
        finally:
            self._give_back()
        return verdict._replace(took_s=time.monotonic() - started)

    def close(self) -> None:
        """End all processes."""
        with self.changed:
            workers, self.all, self.free = self.all, set(), []
            self.changed.notify_all()
        for worker in workers:
            worker.end()

    def _take(self) -> _Worker:
        with self.changed:
            while not self.free and len(self.all) >= self.size:
                self.changed.wait()
            if self.free:
                # Noted as taken before it is taken away: an interrupted caller gives back what it has.
                worker = self.taken[threading.get_ident()] = self.free[-1]
                self.free.pop()
                if worker.process.poll() is None:
                    return worker
                # Something else ended it: that is no verdict on the next pair.
                self.all.discard(worker)
                worker.release()
            # Started under the lock, which takes a millisecond, so that closing the pool misses none.
            worker = self.taken[threading.get_ident()] = _Worker()
            self.all.add(worker)
            return worker

    def _give_back(self) -> None:
        worker = self.taken.pop(threading.get_ident(), None)
        if worker is None or worker in self.free:
            return
        alive = worker.process.poll() is None
        if alive and worker.uses >= _MAX_USES:
            worker.end()
            alive = False
        with self.changed:
            if worker in self.all:
                if not alive:
                    self.all.discard(worker)
                    # Its successor loads while nobody waits for it.
                    worker = _Worker()
                    self.all.add(worker)
                self.free.append(worker)
            else:
                worker.end()
            self.changed.notify()


_lock = threading.Lock()
_pool: Pool | None = None


def shared_pool() -> Pool:
    """Return the pool of this process."""
    global _pool
    with _lock:
        if _pool is None:
            _pool = Pool()
            atexit.register(_pool.close)
        return _pool


def _forget() -> None:
    """After a fork: the processes are the parent's; only our copies of its pipes are closed."""
    global _pool, _lock
    _lock = threading.Lock()
    if _pool is not None:
        atexit.unregister(_pool.close)
        for worker in _pool.all:
            worker.release()
            worker.process.returncode = 0  # not our child: nobody here waits for it
        _pool = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
