"""Programs that run in a container: in a pseudo-terminal, or with their output collected."""

from __future__ import annotations

import contextlib
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import docker.errors

from gem_terminal.backends.docker.engine import FAILURES, Client
from gem_terminal.backends.docker.stream import Stream
from gem_terminal.backends.interface import Completed
from gem_terminal.errors import MachineLostError

START_S = 45.0
"""Seconds in which an engine under load starts a program; one that does not start in them is held by the agent."""
_WRITE_S = 3.0
_LOOK_S = (0.05, 0.1, 0.2, 0.5, 1.0)
_MARK = "gem-terminal:"
# The program's number is said by the shell that turns into it. Errors go the way of the output, so that both come in
# the order in which they were written.
_NAMED = f'exec 2>&1; printf "%s\\n" "{_MARK}$$"; exec "$@"'
_NAMED_IF_THERE = f'command -v "$1" >/dev/null || {{ printf "%s\\n" "{_MARK}none"; exit 127; }}; {_NAMED}'
_FIRST = re.compile(rb"gem-terminal:(\d{1,10}|none)\r?\n")
_KILLED_S = 3.0
_THAW_S = 20.0


@dataclass(frozen=True)
class Wish:
    """What is to be run, and how.

    Args:
        command: Its words.
        user: Who runs it; empty for the container's user.
        workdir: Where; empty for the container's.
        env: Further variables.
    """

    command: Sequence[str]
    user: str = ""
    workdir: str = ""
    env: Mapping[str, str] | None = None


def execute(client: Client, container: str, wish: Wish, *, tty: bool, size: tuple[int, int]) -> str:
    """Tell the engine what to run, and return its name for it; nothing runs yet."""
    said: dict[str, Any] = {
        "Cmd": ["/bin/sh", "-c", _NAMED_IF_THERE if tty else _NAMED, "sh", *wish.command],
        "AttachStdin": tty,
        "AttachStdout": True,
        "AttachStderr": True,
        "Tty": tty,
        "Env": [f"{name}={value}" for name, value in (wish.env or {}).items()],
        "ConsoleSize": [size[1], size[0]],
    }
    if not tty or client.api_version in ("1.40", "1.41"):
        del said["ConsoleSize"]
    if wish.user:
        # By its number: the agent may have given the name another one, in the container's list of users.
        said["User"] = "0" if wish.user == "root" else wish.user
    if wish.workdir:
        said["WorkingDir"] = wish.workdir
    deadline = time.monotonic() + _THAW_S
    while True:
        try:
            return str(client.ask("POST", f"/containers/{container}/exec", json=said).json()["Id"])
        except docker.errors.APIError as error:
            if "is paused" not in str(error) or time.monotonic() > deadline:
                raise
        # Another thread has frozen the container, for the milliseconds in which it ends processes there.
        threading.Event().wait(0.02)


def begin(client: Client, exec_id: str, *, tty: bool) -> Stream:
    """Start what :func:`execute` has prepared."""
    return Stream(client, f"/exec/{exec_id}/start", framed=not tty, body={"Detach": False, "Tty": tty})


class StuckError(Exception):
    """A program has not started, though the engine was told to start it long ago.

    So it is when the agent stops the engine's own process in its container before that turns into the program. The
    engine (20.10) then holds what it knows of the container for itself: to ask for the exit code, the state or the
    processes, or to freeze it, waits for ever, and makes all else wait that is asked after it. To kill it works.
    """


class DockerTerminal:
    """A program in a pseudo-terminal of a container.

    Args:
        client: The client.
        exec_id: The engine's name for it.
        stream: Its input and output.
        columns: Width of the terminal.
        lines: Height of the terminal.
        lost: What happened to the machine; None while it is there.
        hang_up: Sends the hang-up to the program, which the engine does not do.

    Raises:
        MachineLostError: The program could not be started.
        StuckError: It did not start.
    """

    pid = 0

    def __init__(
        self,
        client: Client,
        exec_id: str,
        stream: Stream,
        columns: int,
        lines: int,
        lost: Callable[[], MachineLostError | None],
        hang_up: Callable[[int], None],
    ) -> None:
        self._client = client
        self._exec_id = exec_id
        self._stream = stream
        self._lost = lost
        self._hang_up = hang_up
        self._closed = False
        self._early = b""
        self.pid = self._hear_pid()
        # Refused when the program has ended by now, which the next read says.
        with contextlib.suppress(*FAILURES):
            client.exec_resize(exec_id, height=lines, width=columns)

    def read(self, timeout_s: float) -> bytes:
        """Return what the program wrote, as soon as there is something; ``b""`` when ``timeout_s`` has passed."""
        if self._early:
            data, self._early = self._early, b""
            return data
        heard = None if self._closed else self._stream.read(timeout_s)
        if heard is None:
            raise self._end("the program in the terminal has ended")
        return heard

    def write(self, data: bytes) -> None:
        """Type; what is not taken within a few seconds is dropped."""
        if self._closed:
            raise self._end("the terminal is closed")
        try:
            self._stream.write(data, _WRITE_S)
        except (OSError, ValueError) as error:
            raise self._end("the program in the terminal has ended") from error

    def close(self) -> None:
        """Let go of it; the program gets a hang-up."""
        if self._closed:
            return
        self._closed = True
        self._stream.close()
        if self.pid:
            self._hang_up(self.pid)

    def _hear_pid(self) -> int:
        deadline = time.monotonic() + START_S
        heard = b""
        while len(heard) < 4096:
            data = self._stream.read(max(0.01, deadline - time.monotonic()))
            if data is None:
                break
            if time.monotonic() > deadline and not data:
                self.close()
                raise StuckError
            heard += data
            match = _FIRST.search(heard)
            if match and match.group(1) != b"none":
                self._early = heard[match.end() :]
                return int(match.group(1))
            if match:
                break
        self.close()
        said = " ".join(heard.decode("utf-8", "replace").replace(f"{_MARK}none", "").split())[:300]
        raise self._end(f"the program could not be started{': ' if said else ''}{said}")

    def _end(self, message: str) -> MachineLostError:
        return self._lost() or MachineLostError(message, by_agent=True)


class Running:
    """A command whose output is collected.

    Args:
        client: The client.
        exec_id: The engine's name for it.
        stream: Its output.
        most_output: Bytes that are kept, half of them from the beginning.
    """

    def __init__(self, client: Client, exec_id: str, stream: Stream, most_output: int) -> None:
        self._client = client
        self._exec_id = exec_id
        self._stream = stream
        self._output = Cut(most_output)
        self._first = b""
        self._named = False
        self.pid: int | None = None

    def begin(self) -> None:
        """Wait until it has started; until then nothing else may be asked about the container.

        Raises:
            StuckError: It did not start.
        """
        deadline = time.monotonic() + START_S
        while not self._named:
            data = self._stream.read(max(0.01, deadline - time.monotonic()))
            if data is None:
                return
            self._take(data)
            if not data and time.monotonic() > deadline:
                self._stream.close()
                raise StuckError

    def wait(self, timeout_s: float, kill: Callable[[int | None], None]) -> Completed:
        """Wait for it to end, or kill it; :meth:`begin` comes before.

        Args:
            timeout_s: Seconds that it may take.
            kill: Ends its processes, given its number where that is known.
        """
        with contextlib.closing(self._stream):
            if self._follow(time.monotonic() + timeout_s):
                code = self._code()
                if code is not None:
                    return self._output.completed(code)
            kill(self.pid)
            # What it wrote until then is on its way.
            self._follow(time.monotonic() + _KILLED_S)
        return self._output.completed(None)

    def _follow(self, deadline: float) -> bool:
        """Collect output until the command has ended; False when time runs out before."""
        quiet = 0
        while (left := deadline - time.monotonic()) > 0:
            data = self._stream.read(min(left, _LOOK_S[min(quiet, len(_LOOK_S) - 1)]))
            if data is None:
                return self._ended(left)
            if data:
                self._take(data)
                quiet = 0
                continue
            quiet += 1
            # Something it left in the background may hold its output open: so its own end is asked for.
            if self._code() is not None:
                self._drain()
                return True
        return False

    def _ended(self, left_s: float) -> bool:
        """Wait for the exit code of a command that has closed its output, which it may do long before its end."""
        deadline = time.monotonic() + left_s
        pause = 0.005
        while self._code() is None:
            if time.monotonic() > deadline:
                return False
            threading.Event().wait(pause)
            pause = min(2 * pause, 0.5)
        self._take(b"", last=True)
        return True

    def _drain(self) -> None:
        while data := self._stream.read(0.02):
            self._take(data)
            if self._output.is_flood:
                break
        self._take(b"", last=True)

    def _code(self) -> int | None:
        said = self._client.exec_inspect(self._exec_id)
        code = said.get("ExitCode")
        return None if said.get("Running") or code is None else int(code)

    def _take(self, data: bytes, *, last: bool = False) -> None:
        if self._named:
            self._output.add(data)
            return
        self._first += data
        match = _FIRST.match(self._first)
        if match or last or b"\n" in self._first or len(self._first) > 64:
            self._named = True
            if match and match.group(1) != b"none":
                self.pid = int(match.group(1))
            self._output.add(self._first[match.end() if match else 0 :])


class Cut:
    """Collects output up to a size, from its beginning and its end.

    Args:
        most: Bytes that are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._head = bytearray()
        self._tail = bytearray()
        self._total = 0

    @property
    def is_flood(self) -> bool:
        """Whether more came than is kept by far."""
        return self._total > 16 * self._most + 16_000_000

    def add(self, data: bytes) -> None:
        """Take more output."""
        self._total += len(data)
        room = max(self._most // 2 - len(self._head), 0)
        self._head += data[:room]
        self._tail += data[room:]
        most_tail = self._most - self._most // 2
        if len(self._tail) > 2 * most_tail + 65536:
            del self._tail[: len(self._tail) - most_tail]

    def completed(self, code: int | None) -> Completed:
        """Return what was collected, with an exit code."""
        most_tail = self._most - self._most // 2
        tail = bytes(self._tail[-most_tail:]) if most_tail else b""
        output = bytes(self._head) + tail
        return Completed(code, output, self._total - len(output))
