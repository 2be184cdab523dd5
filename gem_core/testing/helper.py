"""This side of the other process: started once, asked many times, replaced when it dies or hangs."""

from __future__ import annotations

import atexit
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from gem_core.testing.contract import NotTriedError
from gem_core.testing.serialization import encoded

_START_S = 60.0
"""Limit for the interpreter to start; it imports what the checks import, and nothing else."""

_MODULE = "gem_core.testing.other_process"
_START = f"import json, sys; sys.path[:] = json.loads(sys.argv[1]); from {_MODULE} import main; main()"


class HelperError(Exception):
    """The other process did not get through an episode; the message says how it ended."""

    records = 0
    """How many records it gave before."""


class OtherProcess:
    """An interpreter with another hash seed, for any number of environments one after another."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._owner = 0
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._number = 0

    @property
    def pid(self) -> int | None:
        """Its process id, or None while there is no process."""
        return None if self._process is None else self._process.pid

    def play(
        self, request: Mapping[str, Any], *, step_timeout_s: float, reset_timeout_s: float
    ) -> list[dict[str, Any]]:
        """Return the records of an episode that is played there.

        Raises:
            NotTriedError: The process cannot be started, or the environment cannot be made there.
            HelperError: The episode failed, hung, or ended the process.
        """
        with self._lock:
            self._ensure_started()
            self._number += 1
            place = {"number": self._number, "path": sys.path, "directory": os.getcwd()}
            self._send({**place, **request})
            records: list[dict[str, Any]] = []
            limit_s = reset_timeout_s
            while True:
                try:
                    answer = self._receive(limit_s)
                except HelperError as error:
                    error.records = len(records)
                    raise
                limit_s = reset_timeout_s if answer.get("resets") else step_timeout_s
                end = answer.get("end")
                if isinstance(answer.get("record"), dict):
                    records.append(answer["record"])
                elif end == "done":
                    return records
                elif end == "unavailable":
                    raise NotTriedError(f"in another process {answer.get('message')}")
                elif end == "failed":
                    raise HelperError(f"it raised {answer.get('message')}")
                elif answer.get("ready") is not True:
                    self.stop()
                    raise HelperError(f"it said {str(answer)[:200]!r}, which is no answer")

    def stop(self) -> None:
        """End the process, by force where it does not end by itself."""
        process, self._process = self._process, None
        if process is None or self._owner != os.getpid():
            return
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with suppress(OSError):  # what was not sent is for nobody
                    stream.close()

    def _ensure_started(self) -> None:
        alive = self._process is not None and self._owner == os.getpid() and self._process.poll() is None
        if alive:
            return
        self.stop()
        self._process = _start()
        self._owner = os.getpid()
        self._lines = queue.SimpleQueue()
        threading.Thread(target=_pump, args=(self._process, self._lines), daemon=True).start()
        try:
            ready = self._next_line(_START_S)
        except HelperError as error:
            raise NotTriedError(f"no other process could be started ({error}); try 'python -m {_MODULE}'") from error
        if ready.get("ready") is not True:
            self.stop()
            raise NotTriedError(f"the other process began with {str(ready)[:200]!r}; try 'python -m {_MODULE}'")

    def _send(self, message: Mapping[str, Any]) -> None:
        process = self._process
        if process is None or process.stdin is None:
            raise HelperError("it has ended")
        try:
            process.stdin.write(encoded(message))
            process.stdin.flush()
        except OSError as error:
            self.stop()
            raise HelperError(f"it ended before it was asked: {error}") from error

    def _receive(self, timeout_s: float) -> dict[str, Any]:
        answer = self._next_line(timeout_s)
        if answer.get("number") != self._number:
            self.stop()
            raise HelperError(f"it answered {str(answer)[:200]!r}, which nobody asked")
        return answer

    def _next_line(self, timeout_s: float) -> dict[str, Any]:
        try:
            line = self._lines.get(timeout=timeout_s)
        except queue.Empty:
            self.stop()
            raise HelperError(f"it gave no answer within {timeout_s:g} s") from None
        if line is None:
            process = self._process
            code = None if process is None else process.wait()
            self.stop()
            raise HelperError(f"the process ended with exit code {code}")
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError) as error:
            self.stop()
            raise HelperError(f"it said {line[:200]!r}, which is not JSON") from error
        if not isinstance(answer, dict):
            self.stop()
            raise HelperError(f"it said {line[:200]!r}, which is no answer")
        return answer


def _start() -> subprocess.Popen[str]:
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    # Strings hash differently there, so that what depends on the order of a set cannot stay unseen.
    environment["PYTHONHASHSEED"] = "2" if environment.get("PYTHONHASHSEED") == "1" else "1"
    return subprocess.Popen(
        # With this process's own path, so that it imports the same gem_core whatever folder it is started in.
        [sys.executable, "-c", _START, json.dumps([entry or os.getcwd() for entry in sys.path])],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
        encoding="ascii",
    )


def _pump(process: subprocess.Popen[str], lines: queue.SimpleQueue[str | None]) -> None:
    """Read in a thread, since a pipe cannot be read with a time limit on every system."""
    stream = process.stdout
    if stream is not None:
        try:
            for line in stream:
                lines.put(line)
        except (OSError, ValueError):  # the stream was closed by stop()
            pass
    lines.put(None)


_other_process = OtherProcess()
atexit.register(_other_process.stop)


def other_process() -> OtherProcess:
    """Return the other process of this one; it starts with the first episode that it is asked for."""
    return _other_process
