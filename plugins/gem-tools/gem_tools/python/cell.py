"""One sandbox, as the library's process sees it: started, asked, and ended. All of it runs on the library's loop."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from typing import IO, Any

from gem_tools.python import groups
from gem_tools.python.errors import SandboxError
from gem_tools.python.inside import wire
from gem_tools.python.levels import Launch, bootstrap

START_S = 120.0
"""Limit of a sandbox's start, which imports libraries, on however slow a machine."""

GRACE_S = 120.0
"""How much longer than its limit a call may take, before the sandbox itself is taken to hang."""

_END_S = 10.0
_PIECE = 1 << 18

Answer = tuple[dict[str, Any], bytes]


class Cell:
    """A sandbox that runs one call at a time.

    Args:
        launch: How it is started.
        lost: Called once when it is gone, by itself or not.
    """

    def __init__(self, launch: Launch, lost: Callable[[Cell], None]) -> None:
        self.launch, self._lost = launch, lost
        self.process: subprocess.Popen[bytes] | None = None
        self.alive = False
        self.call: object = None
        self.sessions = 0
        self.failed_preload: list[str] = []
        self.filtered = self.walled = False
        self._reader = wire.Reader()
        self._answer: asyncio.Future[Answer] | None = None
        self._outgoing = bytearray()
        self._errors: IO[bytes] | None = None

    async def start(self) -> None:
        """Start it and wait until it is ready.

        Raises:
            SandboxError: It did not start; the message ends with what it wrote.
        """
        loop = asyncio.get_running_loop()
        files, command = [], self.launch.command
        if self.launch.group is not None:
            with contextlib.suppress(OSError):
                files = groups.make(self.launch.group)
                command = groups.joining(self.launch.group, command)
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the sandbox
        # In a session of its own: the Ctrl-C of a terminal is for this process, which ends it.
        try:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                start_new_session=True,
                bufsize=0,
                pass_fds=files,
                **self.launch.popen,
            )
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            self._errors.close()
            raise SandboxError(f"the sandbox did not start: {error}") from error
        finally:
            for file in files:
                os.close(file)
        self._in, self._out = self.process.stdin, self.process.stdout
        for stream in (self._in, self._out):
            os.set_blocking(stream.fileno(), False)  # type: ignore[union-attr]
        self.alive = True
        self._loop = loop
        loop.add_reader(self._fd(self._out), self._read)
        self._answer = loop.create_future()
        self._write(bootstrap({**self.launch.settings, "memory_files": files}))
        try:
            header, _ = await asyncio.wait_for(asyncio.shield(self._answer), START_S)
        except TimeoutError:
            words = self._words()
            self.kill()
            raise SandboxError(f"the sandbox was not ready within {START_S:.0f} s{words}") from None
        except SandboxError as error:
            raise SandboxError(str(error).replace("was lost", "did not start")) from error
        except BaseException:
            self.kill()
            raise
        finally:
            self._answer = None
        self.failed_preload, self.filtered, self.walled = header["failed"], header["filtered"], header["walled"]

    async def ask(self, header: dict[str, Any], body: bytes = b"") -> Answer:
        """Ask for something and return the answer; one question at a time.

        Raises:
            SandboxError: The sandbox was lost before it answered, or kept no limit of time and was ended.
        """
        if not self.alive:
            raise SandboxError("the sandbox is gone")
        self._answer = self._loop.create_future()
        # The keeper inside ends a call in time; this is for a keeper that hangs itself.
        limit_s = header.get("limits", {}).get("wall_s", 0.0) + GRACE_S
        guard = self._loop.call_later(limit_s, self.kill)
        try:
            self._write(wire.pack(header, body))
            return await self._answer
        finally:
            guard.cancel()
            self._answer = None

    def cancel(self, identifier: int) -> None:
        """End the call that runs; its answer comes as always."""
        if self.alive:
            self._write(wire.pack({"op": "cancel", "id": identifier}))

    def close(self) -> None:
        """Let it end by itself, without waiting: it sees that nobody asks any more."""
        if self.alive:
            self._forget()
            self._fail("the sandbox was closed")
            self._lost(self)

    def kill(self) -> None:
        """End it at once."""
        process = self.process
        self.close()
        if process is not None:
            wait_for_end(process, 0.0)

    def after_fork(self) -> None:
        """In a child of the library's process: let go of what belongs to the parent, without a word to the sandbox."""
        self.alive = False
        if self.process is not None:
            for stream in (self._in, self._out):
                with contextlib.suppress(OSError, ValueError):
                    stream.close()  # type: ignore[union-attr]
            self.process.returncode = 0  # not ours to wait for

    def _fd(self, stream: IO[bytes] | None) -> int:
        return -1 if stream is None else stream.fileno()

    def _read(self) -> None:
        try:
            data = os.read(self._fd(self._out), _PIECE)
            messages = self._reader.feed(data)
        except (BlockingIOError, InterruptedError):
            return
        except (OSError, wire.WireError):
            data, messages = b"", []
        for message in messages:
            if self._answer is not None and not self._answer.done():
                self._answer.set_result(message)
        if not data:
            self._gone()

    def _gone(self) -> None:
        if not self.alive:
            return
        words = self._words()
        self._forget()
        self._fail(f"the sandbox was lost{words}")
        self._lost(self)

    def _fail(self, message: str) -> None:
        """Tell whoever waits for an answer that none will come."""
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(SandboxError(message))

    def _forget(self) -> None:
        self.alive = False
        self._loop.remove_reader(self._fd(self._out))
        self._loop.remove_writer(self._fd(self._in))
        for stream in (self._in, self._out, self._errors):
            if stream is not None:
                stream.close()
        if self.process is not None:
            _reap(self._loop, self.process)

    def _write(self, data: bytes) -> None:
        if not self._outgoing:
            data = data[self._sent(data) :]
        if data:
            if not self._outgoing:
                self._loop.add_writer(self._fd(self._in), self._write_on)
            self._outgoing += data

    def _write_on(self) -> None:
        del self._outgoing[: self._sent(self._outgoing)]
        if not self._outgoing:
            self._loop.remove_writer(self._fd(self._in))

    def _sent(self, data: bytes | bytearray) -> int:
        try:
            return os.write(self._fd(self._in), data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            return len(data)  # it is gone, which reading will tell

    def _words(self) -> str:
        """Return the end of what the sandbox wrote to its standard error."""
        if self._errors is None or self._errors.closed:
            return ""
        try:
            size = self._errors.seek(0, os.SEEK_END)
            self._errors.seek(max(0, size - 600))
            text = " ".join(self._errors.read().decode("utf-8", "replace").split())
        except (OSError, ValueError):
            return ""
        return f": {text}" if text else ""


def _reap(loop: asyncio.AbstractEventLoop, process: subprocess.Popen[bytes], began: float | None = None) -> None:
    """Wait for a process that is about to end, now and then; kill it when it takes too long."""
    now = time.monotonic()
    began = now if began is None else began
    if process.poll() is None:
        if now - began > _END_S:
            kill_group(process)
        loop.call_later(0.02 if now - began < 1 else 0.5, _reap, loop, process, began)


def wait_for_end(process: subprocess.Popen[bytes], limit_s: float) -> None:
    """Wait for a process to end; kill it when it takes too long."""
    try:
        process.wait(limit_s)
    except subprocess.TimeoutExpired:
        kill_group(process)
        process.wait()


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a sandbox's own process and those of its session."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        process.kill()
