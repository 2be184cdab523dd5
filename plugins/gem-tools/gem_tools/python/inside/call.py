"""One call: its code and output are passed on, its limits are kept, its end is told."""

from __future__ import annotations

import contextlib
import mmap
import os
import select
import time
from typing import TYPE_CHECKING, Any

from gem_tools.python.inside import confine, usage
from gem_tools.python.inside.child import AT, LENGTH

if TYPE_CHECKING:
    from collections.abc import Callable

    from gem_tools.python.inside.forks import Forks, Process

_FIRST_LOOK_S, _NEXT_LOOK_S = 0.02, 0.05
_ENDING_S = 2.0
_MAX_RESULT = 1 << 24
_OWN_BYTES = 4 << 20
"""What a process may hold of its interpreter's own beyond its limit, at which it gets a MemoryError by itself."""

_SETUP_S = 30.0
"""Limit of what happens before code begins; what takes longer is a fault of the sandbox."""

OUT, ERR, RESULT = 0, 1, 2
"""The streams of a call."""


def unforked(size: int) -> memoryview:
    """Return memory that no forked process gets: what passes through it stays unknown to later calls."""
    memory = mmap.mmap(-1, size)
    memory.madvise(mmap.MADV_DONTFORK)
    return memoryview(memory)


class Call:
    """A call that runs. The keeper's loop tells it of everything that happens.

    Args:
        forks: The processes of the sandbox.
        process: That runs the code.
        header: What was asked, with its limits.
        send: Sends a message with a body to the library.
        poller: Of the keeper.
    """

    piece = unforked(1 << 16)

    def __init__(
        self,
        forks: Forks,
        process: Process,
        header: dict[str, Any],
        send: Callable[[dict[str, Any], memoryview], None],
        poller: select.poll,
    ) -> None:
        self.forks, self.process, self.send, self.poller = forks, process, send, poller
        self.id: int = header["id"]
        self.session: str | None = header.get("session")
        self.limits: dict[str, Any] = header["limits"]
        self.streams = {process.out: OUT, process.err: ERR, process.job.fileno(): RESULT}
        self.output_bytes = 0
        # The length of the result, and how much of it is still to come.
        self.result_head = b""
        self.result_left: int | None = None
        self.failed: str | None = None
        self.ended: str | None = None
        self.began = time.monotonic()
        # No process of a session says when a later call begins: by then it has run code, which may say anything.
        self.started = None if process.fresh else self.began
        process.fresh = False
        self.cpu_before = usage.cpu_s(forks.proc, [process.pid]) if self.session is not None else 0.0
        self.cpu_s = self.wall_s = 0.0
        self.peak_bytes = 0
        self.next_look = self.began + _FIRST_LOOK_S
        self.lost_after = float("inf")
        self.to_hand_over = memoryview(b"")
        self.watched: dict[int, int] = {}
        for descriptor in self.streams:
            self.watch(descriptor, select.POLLIN)

    @property
    def over(self) -> bool:
        """Whether the process has ended, or the session has answered."""
        return self.process.exit is not None or (self.session is not None and self.result_left == 0)

    def attend(self, descriptor: int, event: int) -> None:
        """Read or write where something happened."""
        if event & select.POLLOUT:
            self.hand_over(self.to_hand_over)
        if not event & ~select.POLLOUT:
            return
        count = self.read(descriptor)
        while count and self.streams[descriptor] == RESULT:
            count = self.read(descriptor)
        if count == 0:
            self.watch(descriptor, self.watched[descriptor] & ~select.POLLIN)

    def watch(self, descriptor: int, events: int) -> None:
        """Have the keeper look at a stream for some events."""
        self.watched[descriptor] = events
        if events:
            self.poller.register(descriptor, events)
        else:
            with contextlib.suppress(KeyError):
                self.poller.unregister(descriptor)

    def hand_over(self, data: memoryview) -> None:
        """Send the process data; what it does not take now is kept, and sent when it does."""
        job = self.process.job
        try:
            data = data[job.send(data) :]
        except BlockingIOError:
            pass
        except OSError:
            data = data[:0]  # nobody reads: its end will tell
        self.to_hand_over = data
        listening = self.watched[job.fileno()] & ~select.POLLOUT
        self.watch(job.fileno(), listening | select.POLLOUT if data else listening)

    def keep_limits(self) -> float:
        """End the call where a limit is reached; return the seconds until the next look."""
        now = time.monotonic()
        if self.ended is not None:
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
            self.forks.kill(self.process)

    def look(self) -> None:
        """Add up what all processes of the call use."""
        pids, most = self.forks.of_call(self.process), (self.limits["memory_mb"] << 20) + _OWN_BYTES
        used = self.memory(pids)
        if used > most:
            # While processes end, what they shared is counted for each of those that are left: look again.
            pids = self.forks.of_call(self.process)
            used = min(used, self.memory(pids))
        self.peak_bytes = max(self.peak_bytes, used)
        if used > most:
            self.end("memory")
        elif usage.cpu_s(self.forks.proc, pids) - self.cpu_before > self.limits["cpu_s"]:
            self.end("cpu")

    def memory(self, pids: list[int]) -> int:
        """Return the bytes that the processes, and files in memory, hold."""
        forks, process = self.forks, self.process
        if forks.namespaces:
            files = usage.folder_bytes(forks.proc, process.pid, process.folder)
        else:
            files = usage.tree_bytes(process.folder)
            if process.uid is not None:
                files += usage.tree_bytes(confine.SHARED, process.uid)
        return files + usage.memory(forks.proc, pids, forks.memory_bytes)

    def read(self, descriptor: int) -> int | None:
        """Read what a stream holds now; return how many bytes, 0 at its end, None where nothing has come."""
        stream = self.streams[descriptor]
        try:
            if stream != RESULT:
                return self.read_output(stream, descriptor)
            if self.started is None:
                return self.begin()
            if self.result_left != 0 and (count := self.read_result()):
                return count
        except BlockingIOError:
            return None
        except OSError:
            pass
        if self.session is not None and self.result_left != 0:
            # Its end follows at once, if it is ending.
            self.lost_after = min(self.lost_after, time.monotonic() + _ENDING_S)
        return 0

    def begin(self) -> int:
        """Note what a process says before it has seen any code, and can be believed: that code begins, or why not."""
        data = self.process.job.recv(AT.size)
        if len(data) == AT.size:
            (at,) = AT.unpack(data)
            if at < 0:
                self.failed = self.process.job.recv(1000).decode("utf-8", "replace")
            else:
                # One clock for all processes of a machine.
                self.started = min(time.monotonic(), at)
                self.next_look = self.started + _FIRST_LOOK_S
        return len(data)

    def read_result(self) -> int:
        """Pass on what code has left of its result, a length and so many bytes, in pieces of any size."""
        if self.result_left is None:
            data = self.process.job.recv(LENGTH.size - len(self.result_head))
            self.result_head += data
            if len(self.result_head) == LENGTH.size:
                (length,) = LENGTH.unpack(self.result_head)
                if not 0 < length <= _MAX_RESULT:
                    return 0
                self.result_left = length
            return len(data)
        count = self.process.job.recv_into(self.piece, min(self.result_left, len(self.piece)))
        self.send({"stream": RESULT}, self.piece[:count])
        self.result_left -= count
        return count

    def read_output(self, stream: int, descriptor: int) -> int:
        """Pass on what is written."""
        count = os.readv(descriptor, [self.piece])
        if count:
            self.send({"stream": stream}, self.piece[:count])
        self.output_bytes += count
        if self.output_bytes > self.limits["output_stop_bytes"]:
            self.end("output")
        return count

    def finish(self) -> dict[str, Any]:
        """Stop the session, pass on what is left, and return what the library is told of the end."""
        process, now = self.process, time.monotonic()
        if process.exit is None:
            self.cpu_s = usage.cpu_s(self.forks.proc, [process.pid]) - self.cpu_before
            self.forks.still(process)
        for descriptor in self.streams:
            while self.read(descriptor) and self.ended != "output":
                pass
            self.watch(descriptor, 0)
        if self.ended is not None:
            self.forks.wait_for(process)
        ended = process.exit
        if ended is not None:
            self.cpu_s = max(0.0, ended.cpu_s - self.cpu_before)
            self.peak_bytes = max(self.peak_bytes, ended.max_bytes - self.forks.memory_bytes)
        if self.started is not None:
            self.wall_s = max(0.0, (now if ended is None else ended.at) - self.started)
            if self.ended == "timeout" and self.wall_s < self.limits["wall_s"]:
                self.ended = None  # it had ended by itself; the end of what it left took so long
        return {
            "id": self.id,
            "ended": self.ended,
            "failed": self.failed,
            "status": None if ended is None else ended.status,
            "wall_s": self.wall_s,
            "cpu_s": self.cpu_s,
            "peak_bytes": self.peak_bytes,
            "reported": self.result_left == 0,
            "lost": self.session is not None and ended is not None,
        }
