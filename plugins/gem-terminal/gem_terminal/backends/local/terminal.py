"""A program in a pseudo-terminal of a machine, and what becomes of a command's output."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable

from gem_terminal.errors import MachineLostError

_PIECE = 65_536
_WRITE_S = 3.0


class LocalTerminal:
    """A program in a pseudo-terminal. Not for several threads at once.

    Args:
        pid: The program's process number, as its own machine counts.
        controlling: File descriptor of the terminal's controlling end.
        ended: File descriptor that is at its end when the program is.
        why_lost: Says what happened to the machine.
    """

    def __init__(self, pid: int, controlling: int, ended: int, why_lost: Callable[[], MachineLostError | None]) -> None:
        self.pid = pid
        self._controlling, self._ended, self._why_lost = controlling, ended, why_lost
        self._closed = self._over = False
        os.set_blocking(controlling, False)

    def read(self, timeout_s: float) -> bytes:
        """Return what the program wrote, as soon as there is something; ``b""`` when ``timeout_s`` has passed.

        Raises:
            MachineLostError: The program has ended, and all that it wrote was read; or the machine is gone.
        """
        self._check_open()
        poller = select.poll()
        poller.register(self._controlling, select.POLLIN)
        poller.register(self._ended, select.POLLIN)
        ready = {descriptor for descriptor, _ in poller.poll(max(0, int(timeout_s * 1000)))}
        if not ready:
            return b""
        data = self._take()
        if data:
            return data
        if data is None or self._ended in ready:
            raise self._gone()
        return b""

    def write(self, data: bytes) -> None:
        """Type; what the program has not taken after a few seconds is dropped.

        Raises:
            MachineLostError: The program has ended, or the machine is gone.
        """
        self._check_open()
        deadline = time.monotonic() + _WRITE_S
        view = memoryview(data)
        poller = select.poll()
        poller.register(self._controlling, select.POLLOUT)
        gone = select.poll()
        gone.register(self._ended, select.POLLIN)
        while view:
            left = deadline - time.monotonic()
            if self._over or gone.poll(0):
                raise self._gone()
            if left <= 0 or not poller.poll(left * 1000):
                return
            try:
                view = view[os.write(self._controlling, view[:4096]) :]
            except BlockingIOError:
                # A line longer than the terminal holds is never taken, though it says that it can be written to.
                gone.poll(min(left, 0.05) * 1000)
            except OSError as error:
                raise self._gone() from error

    def close(self) -> None:
        """Let go of it; the program gets a hang-up."""
        if not self._closed:
            self._closed = True
            os.close(self._controlling)
            os.close(self._ended)

    def _take(self) -> bytes | None:
        """Return what can be read at once; None at the end."""
        try:
            return os.read(self._controlling, _PIECE) or None
        except BlockingIOError:
            return b""
        except OSError:
            return None  # nobody holds the other end any more

    def _check_open(self) -> None:
        if self._closed:
            raise MachineLostError("the terminal is closed", by_agent=None)

    def _gone(self) -> MachineLostError:
        # The terminal ends with its program, a moment before it is known that the program has.
        self._over = True
        return self._why_lost() or MachineLostError("the program in the terminal has ended", by_agent=True)


class Middle:
    """Keeps the beginning and the end of what is added.

    Args:
        most: Bytes to keep.
    """

    def __init__(self, most: int) -> None:
        self._room = most - most // 2
        self._most_tail = most // 2
        self._head, self._tail = bytearray(), bytearray()
        self.dropped = 0

    def add(self, data: bytes) -> None:
        """Add what comes next."""
        taken = self._room - len(self._head)
        self._head += data[:taken]
        self._tail += data[taken:]
        if len(self._tail) > 2 * self._most_tail + _PIECE:
            self._cut()

    def _cut(self) -> None:
        beyond = max(0, len(self._tail) - self._most_tail)
        self.dropped += beyond
        del self._tail[:beyond]

    def whole(self) -> bytes:
        """Return what was kept."""
        self._cut()
        return bytes(self._head + self._tail)


def follow(output: int, done: int, deadline: float, take: Callable[[bytes], None]) -> int | None:
    """Read a command's output until it has ended; what others still hold open is not waited for.

    Args:
        output: File descriptor of its output, not blocking.
        done: File descriptor that gets its exit code as a byte, or ends without one when its minder was killed.
        deadline: When to stop, as ``time.monotonic`` counts.
        take: Gets the output.

    Returns:
        Its exit code; 137 where its minder was killed; None where time ran out.
    """
    poller = select.poll()
    poller.register(output, select.POLLIN)
    poller.register(done, select.POLLIN)
    while (left := deadline - time.monotonic()) > 0:
        ready = {descriptor for descriptor, _ in poller.poll(left * 1000)}
        if output in ready and not _pass_on(output, take):
            poller.unregister(output)
        if done in ready:
            code = os.read(done, 1)
            drain(output, take)
            return code[0] if code else 137
    return None


def drain(output: int, take: Callable[[bytes], None], most: int = 1 << 21) -> None:
    """Pass on what has been written, without waiting; others may go on writing for ever, hence a limit in bytes."""
    counted = 0

    def counting(data: bytes) -> None:
        nonlocal counted
        counted += len(data)
        take(data)

    while counted < most and _pass_on(output, counting, at_once=True):
        pass


def _pass_on(output: int, take: Callable[[bytes], None], *, at_once: bool = False) -> bool:
    try:
        data = os.read(output, _PIECE)
    except BlockingIOError:
        return not at_once
    if data:
        take(data)
    return bool(data)
