"""One call, watched by the keeper: its output is read, its limits are kept, its end is told."""

from __future__ import annotations

import json
import os
import select
import time
from typing import TYPE_CHECKING, Any

from gem_tools.python.inside import confine, memory, watch, wire

if TYPE_CHECKING:
    import socket

    from gem_tools.python.inside.keeper import Child, Keeper

_PIECE = 1 << 16
_FIRST_LOOK_S, _NEXT_LOOK_S = 0.02, 0.05
_ENDING_S = 2.0
_MAX_RESULT = 1 << 24
_SETUP_S = 30.0
"""Limit of what happens before code begins; what takes longer is a fault of ours."""


class Output:
    """The beginning and the end of what a stream brings; the middle is counted and dropped.

    Args:
        most: Bytes that are kept.
    """

    def __init__(self, most: int) -> None:
        self._head_most = most - most // 2
        self._tail_most = most // 2
        self._head = bytearray()
        self._tail = bytearray()
        self.total = 0

    def add(self, data: bytes) -> None:
        """Take in a piece."""
        self.total += len(data)
        free = self._head_most - len(self._head)
        if free > 0:
            self._head += data[:free]
            data = data[free:]
        if data:
            self._tail += data
            if len(self._tail) > 2 * self._tail_most + _PIECE:
                del self._tail[: len(self._tail) - self._tail_most]

    def parts(self) -> tuple[bytes, bytes]:
        """Return what is kept, before and behind the gap."""
        tail = self._tail[len(self._tail) - self._tail_most :] if len(self._tail) > self._tail_most else self._tail
        return bytes(self._head), bytes(tail)


class Call:
    """A call that runs.

    Args:
        keeper: Of the sandbox.
        child: The process that runs the code.
        header: What was asked, with its limits.
        body: The code and its input, not looked at here.
    """

    def __init__(self, keeper: Keeper, child: Child, header: dict[str, Any], body: bytes) -> None:
        self.keeper, self.child = keeper, child
        self.limits: dict[str, Any] = header["limits"]
        self.session = header.get("session") is not None
        self.to_send = memoryview(wire.pack({"limits": self.limits}, body))
        self.outputs = {child.out: Output(self.limits["output_bytes"]), child.err: Output(self.limits["output_bytes"])}
        self.result: bytes | None = None
        self.failed: str | None = None
        self.ended: str | None = None
        self.began = time.monotonic()
        # No process of a session says when a later call begins: by then it has run code, which may say anything.
        self.started = None if child.fresh else self.began
        child.fresh = False
        self.told = bytearray()
        self.cpu_before = self.cpu_s = 0.0
        self.wall_s = 0.0
        self.peak_bytes = 0
        self.group_before = 0 if keeper.group is None else keeper.group.memory()
        self.next_look = self.began + _FIRST_LOOK_S
        self.done = False
        self.lost_after = float("inf")

    def run(self) -> None:
        """Watch until the process has ended, or until a session has answered."""
        if self.session:
            self.cpu_before = watch.cpu_s(self.keeper.proc, [self.child.pid])
        poller = self.keeper.poller
        for descriptor in (self.child.out, self.child.err):
            poller.register(descriptor, select.POLLIN)
        poller.register(self.child.job, select.POLLIN | select.POLLOUT)
        self.poller = poller
        try:
            while not self.done and self.child.exit is None:
                self.turn()
            if self.started is not None:
                end = time.monotonic() if self.child.exit is None else self.child.exit["at"]
                self.wall_s = max(0.0, end - self.started)
        finally:
            self.forget(self.child.job)
            for descriptor in self.outputs:
                self.forget(descriptor)
        if self.session and self.child.exit is None:
            self.cpu_s = watch.cpu_s(self.keeper.proc, [self.child.pid]) - self.cpu_before
            self.keeper.still(self.child)
            self.child.held_bytes = self.grown()
        elif self.child.exit is not None:
            self.cpu_s = max(0.0, self.child.exit["cpu_s"] - self.cpu_before)
            self.peak_bytes = max(self.peak_bytes, self.child.exit["maxrss_kb"] * 1024 - self.keeper.base_bytes)
            self.read_job()
        for descriptor in self.outputs:
            self.read_output(descriptor, to_the_end=True)

    def turn(self) -> None:
        """Wait for something to happen, and see to it."""
        for descriptor, event in self.poller.poll(self.keep_limits() * 1000 + 0.5):
            if descriptor in self.outputs:
                if not self.read_output(descriptor):
                    self.forget(descriptor)
            elif descriptor == self.child.job.fileno():
                if event & select.POLLOUT:
                    self.send_job()
                if event & ~select.POLLOUT:
                    self.read_job()
            else:
                self.keeper.attend(descriptor)

    def keep_limits(self) -> float:
        """End the call where a limit is reached; return the seconds until the next look."""
        now = time.monotonic()
        if self.child.ended or self.ended is not None:
            return 1.0
        if self.started is None:
            until = self.began + _SETUP_S
            if now >= until:
                self.failed = f"a process was not ready within {_SETUP_S:.0f} s"
                self.end("setup")
            return max(0.0, until - now)
        end: float = self.started + self.limits["wall_s"]
        if now >= end:
            self.end("timeout")
        elif now >= self.lost_after:
            self.end("lost")
        elif now >= self.next_look:
            self.next_look = now + _NEXT_LOOK_S
            self.look()
        return max(0.0, min(end, self.next_look) - now)

    def end(self, why: str) -> None:
        """Kill the process, and with it all that it started."""
        if self.ended is None:
            self.ended = why
            self.keeper.kill(self.child)

    def look(self) -> None:
        """Add up what all processes of the call use."""
        pids, most = self.keeper.members(self.child), self.limits["memory_mb"] << 20
        # A process may copy all that it shares with the one that it was forked from: that is the interpreter's own.
        used = self.added_up(pids) if self.keeper.group is None else max(0, self.grown() - self.keeper.base_bytes)
        if used > most and self.keeper.group is None:
            # While processes end, what they shared is counted for each of those that are left: look again.
            pids = self.keeper.members(self.child)
            used = min(used, self.added_up(pids))
        self.peak_bytes = max(self.peak_bytes, used)
        if used > most:
            self.end("memory")
        elif watch.cpu_s(self.keeper.proc, pids) - self.cpu_before > self.limits["cpu_s"]:
            self.end("cpu")

    def grown(self) -> int:
        """Return what the sandbox holds more than before this call, and what a session held from earlier ones."""
        group = self.keeper.group
        return 0 if group is None else max(0, self.child.held_bytes + group.memory() - self.group_before)

    def added_up(self, pids: list[int]) -> int:
        """Add up what the processes, and files in memory, hold, where no group counts it."""
        keeper, child = self.keeper, self.child
        if keeper.settings["namespaces"]:
            files = memory.folder_bytes(keeper.proc, child.pid, child.folder)
        else:
            files = memory.tree_bytes(child.folder)
            if child.uid is not None:
                files += memory.tree_bytes(confine.SHARED, child.uid)
        return files + memory.added_up(keeper.proc, pids, keeper.base_bytes)

    def send_job(self) -> None:
        """Hand over the code and its input, as fast as it is read."""
        try:
            sent = self.child.job.send(self.to_send)
        except BlockingIOError:
            return
        except OSError:
            sent = len(self.to_send)  # nobody reads: its end will tell
        self.to_send = self.to_send[sent:]
        if not self.to_send:
            self.poller.modify(self.child.job, select.POLLIN)

    def read_job(self) -> None:
        """Read what the process says: at first that it is ready, or why not; then its result, and nothing more."""
        try:
            data = self.child.job.recv(_PIECE)
            self.told += data
            if self.started is None and (ready := wire.framed(self.told, _MAX_RESULT)) is not None:
                self.begin(json.loads(ready))
            if self.started is not None and self.result is None:
                self.result = wire.framed(self.told, _MAX_RESULT)
        except BlockingIOError:
            return
        except (OSError, wire.WireError):
            data = b""
        if self.result is not None:
            self.done = self.session
        if not data or self.result is not None:
            self.forget(self.child.job)
            if not data and self.session and self.result is None:
                # Its end follows at once, if it is ending.
                self.lost_after = min(self.lost_after, time.monotonic() + _ENDING_S)

    def begin(self, ready: dict[str, Any]) -> None:
        """Note what a process says before it has seen any code, and can be believed."""
        if "error" in ready:
            self.failed = str(ready["error"])[:1000]
        else:
            # One clock for all processes of a machine.
            self.started = min(time.monotonic(), ready["at"])
            self.next_look = self.started + _FIRST_LOOK_S

    def read_output(self, descriptor: int, *, to_the_end: bool = False) -> bool:
        """Take in what a stream holds now; False at its end."""
        output = self.outputs[descriptor]
        while True:
            try:
                data = os.read(descriptor, _PIECE)
            except BlockingIOError:
                return True
            except OSError:
                return False
            if not data:
                return False
            output.add(data)
            if sum(each.total for each in self.outputs.values()) > self.limits["output_stop_bytes"]:
                self.end("output")
            if not to_the_end or self.ended == "output":
                return True

    def forget(self, what: int | socket.socket) -> None:
        """Look no more at a stream."""
        try:
            self.poller.unregister(what)
        except (KeyError, ValueError):
            return

    def answer(self, identifier: int) -> bytes:
        """Return the message that tells the library of all this."""
        parts = [part for output in self.outputs.values() for part in output.parts()]
        ended = self.child.exit
        header = {
            "id": identifier,
            "ended": self.ended,
            "failed": self.failed,
            "status": None if ended is None else ended["status"],
            "wall_s": self.wall_s,
            "cpu_s": self.cpu_s,
            "peak_bytes": self.peak_bytes,
            "totals": [output.total for output in self.outputs.values()],
            "lengths": [*map(len, parts), -1 if self.result is None else len(self.result)],
            "lost": self.session and ended is not None,
        }
        return wire.pack(header, b"".join([*parts, self.result or b""]))
