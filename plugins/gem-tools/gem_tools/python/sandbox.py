"""One sandbox, as the library's process sees it: started, asked, and ended."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import tempfile
from collections.abc import Callable
from typing import Any

from gem_tools.python import docker
from gem_tools.python.errors import SandboxError
from gem_tools.python.inside import confine, wire
from gem_tools.python.levels import Launch, bootstrap
from gem_tools.python.limits import Limits
from gem_tools.python.outcome import Output

START_S = 120.0
"""Limit of a sandbox's start, which imports libraries, on however slow a machine."""

GRACE_S = 120.0
"""How much longer than its limit a call may take, before the sandbox itself is taken to hang."""

END_S = 12.0
"""Limit of a sandbox's end, after which it is killed."""

_MAX_HEADER, _MAX_BODY = 1 << 20, 1 << 24

_listening: set[asyncio.Task[None]] = set()
"""What sandboxes answer is taken in by these; a loop keeps only weak references to its tasks."""

Answer = tuple[dict[str, Any], list[Output]]
"""A header, and the streams of a call: output, error output, result."""


class Sandbox:
    """A sandbox that runs one call at a time. All but ``clear`` runs on the library's loop.

    Args:
        launch: How it is started.
        lost: Called once when it is gone without having been closed.
    """

    def __init__(self, launch: Launch, lost: Callable[[Sandbox], None] = lambda sandbox: None) -> None:
        self.launch, self._lost = launch, lost
        self.process: subprocess.Popen[bytes] | None = None
        self.alive = False
        self.ready: dict[str, Any] = {}
        self.answer: asyncio.Future[Answer] | None = None
        self._streams: list[Output] = []

    async def start(self) -> None:
        """Start it and wait until it is ready.

        Raises:
            SandboxError: It did not start; the message ends with what it wrote.
        """
        self._socket, theirs = socket.socketpair()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the sandbox
        # In a session of its own: the Ctrl-C of a terminal is for this process, which ends it.
        try:
            self.process = subprocess.Popen(
                self.launch.command,
                stdin=theirs.fileno(),
                stdout=theirs.fileno(),
                stderr=self._errors,
                start_new_session=True,
                **self.launch.popen,
            )
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            self._socket.close()
            self._errors.close()
            raise SandboxError(f"the sandbox did not start: {error}") from error
        finally:
            theirs.close()
        self._reader, self._writer = await asyncio.open_connection(sock=self._socket)
        self.alive = True
        listening = asyncio.ensure_future(self._listen())
        _listening.add(listening)
        listening.add_done_callback(_listening.discard)
        try:
            async with asyncio.timeout(START_S):
                self.ready, _ = await self._asked(bootstrap(self.launch.settings))
                await self._try()
        except TimeoutError:
            words = self._words()
            self.close()
            raise SandboxError(f"the sandbox was not ready within {START_S:.0f} s{words}") from None
        except SandboxError as error:
            self.close()
            raise SandboxError(str(error).replace("was lost", "did not start")) from error
        except BaseException:
            self.close()
            raise

    async def _try(self) -> None:
        """Run an empty program, which shows whether code can be run at all."""
        settings = self.launch.settings
        limits = Limits(wall_s=30.0, folder_mb=settings["folder_mb"], folder_files=settings["folder_files"])
        header = {"op": "run", "id": 0, "limits": limits.told(session=False), "value": False, "job": 0, "input": 0}
        answer, (_, err, _) = await self.ask(header)
        if answer["failed"] is not None or answer["status"] != 0:
            raise SandboxError(f"the sandbox does not work: {answer['failed'] or err.text()[-600:]}")

    async def ask(self, header: dict[str, Any], body: bytes = b"") -> Answer:
        """Ask for something and return the answer; one question at a time.

        Raises:
            SandboxError: The sandbox was lost before it answered, or kept no limit of time and was ended.
        """
        if not self.alive:
            raise SandboxError("the sandbox is gone")
        limits = header.get("limits", {"wall_s": 0.0, "output_bytes": 0})
        self._streams = [Output(limits["output_bytes"]), Output(limits["output_bytes"]), Output(_MAX_BODY)]
        # The process inside ends a call in time; this is for one that hangs itself.
        guard = asyncio.get_running_loop().call_later(limits["wall_s"] + GRACE_S, self._give_up)
        try:
            return await self._asked(wire.head(header, 0) + body)
        finally:
            guard.cancel()

    async def _asked(self, data: bytes) -> Answer:
        self.answer = asyncio.get_running_loop().create_future()
        try:
            self._writer.write(data)
            return await self.answer
        finally:
            self.answer = None

    def cancel(self, identifier: int) -> None:
        """End the call that runs; its answer comes as always."""
        if self.alive:
            self._writer.write(wire.head({"op": "cancel", "id": identifier}, 0))

    async def _listen(self) -> None:
        """Take in answers until the sandbox is gone."""
        with contextlib.suppress(OSError, EOFError, ValueError, RecursionError):
            while True:
                length, body_length = wire.LENGTHS.unpack(await self._reader.readexactly(wire.LENGTHS.size))
                if length > _MAX_HEADER or body_length > _MAX_BODY:
                    break
                header = json.loads(await self._reader.readexactly(length))
                body = await self._reader.readexactly(body_length)
                if "stream" in header:
                    self._streams[header["stream"]].add(body)
                elif self.answer is not None and not self.answer.done():
                    self.answer.set_result((header, self._streams))
        if self.alive:
            self._disconnect(f"the sandbox was lost{self._words()}")
            self._lost(self)

    def close(self) -> None:
        """Let it end by itself, without waiting: it sees that nobody asks any more."""
        self._disconnect("the sandbox was closed")

    def clear(self) -> None:
        """Wait for its end, kill it when it takes too long, and remove what it left then; blocks for some seconds."""
        if self.process is None:
            return
        try:
            self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._kill(self.process)
            self.process.wait()
        if self.launch.base is not None:
            confine.remove_folder(self.launch.base)
        if self.launch.container is not None and self.process.returncode:
            docker.remove(self.launch.container)

    def after_fork(self) -> None:
        """In a child of the library's process: let go of what belongs to the parent, without a word to the sandbox."""
        self.alive = False
        if self.process is not None:
            self._socket.close()
            self.process.returncode = 0  # not ours to wait for

    def _give_up(self) -> None:
        if self.alive and self.process is not None:
            self._kill(self.process)
            self._disconnect("the sandbox was closed")
            self._lost(self)

    def _disconnect(self, message: str) -> None:
        if not self.alive:
            return
        self.alive = False
        self._writer.transport.abort()
        self._errors.close()
        if self.answer is not None and not self.answer.done():
            self.answer.set_exception(SandboxError(message))

    def _kill(self, process: subprocess.Popen[bytes]) -> None:
        """Kill the sandbox's own process and those of its session."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            process.kill()

    def _words(self) -> str:
        """Return the end of what the sandbox wrote to its standard error."""
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, size - 600))
        text = " ".join(self._errors.read().decode("utf-8", "replace").split())
        return f": {text}" if text else ""
