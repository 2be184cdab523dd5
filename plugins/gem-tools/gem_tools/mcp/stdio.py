"""The transport ``stdio``: a server as a child process that ends with us, however we end.

Like the library's own transport, with what untrusted servers need besides: messages are bounded, what is no message
does no harm, standard error is kept for error messages instead of being printed, and all that a server starts ends with
it.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import os
import shutil
import signal
import sys
import time
from collections import deque
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anyio
from anyio.streams.memory import MemoryObjectReceiveStream, MemoryObjectSendStream
from mcp.shared.message import SessionMessage

from gem_core.errors import MissingRequirementError, refuse_windows
from gem_tools.mcp.messages import Lines, shortened

if TYPE_CHECKING:
    from gem_tools.mcp.config import Server

END_S = 1.0
"""How long a server has to end by itself once its standard input is closed (the protocol's way to end it)."""

KILL_S = 6.0
"""How long its keeper has to end all that is left; longer than the keeper's own limits."""

HARMLESS = ("HOME", "LANG", "LC_ALL", "LC_CTYPE", "LOGNAME", "PATH", "SHELL", "TERM", "TMPDIR", "TZ", "USER")
"""Variables of the environment that every server gets."""

KEEPER = str(Path(__file__).with_name("keeper.py"))
_CHUNK = 1 << 16

_keepers: set[int] = set()
"""Process ids of the keepers that run."""

Streams = tuple[MemoryObjectReceiveStream[SessionMessage | Exception], MemoryObjectSendStream[SessionMessage]]


class Remarks:
    """What a server said besides messages, for when something goes wrong."""

    def __init__(self) -> None:
        self.stderr: deque[str] = deque(maxlen=20)
        self.stdout: deque[str] = deque(maxlen=5)
        self.exit_code: int | None = None

    def __str__(self) -> str:
        said = [line for line in self.stderr if line][-5:]
        parts = [] if self.exit_code is None else [_how_it_ended(self.exit_code)]
        if said:
            parts.append(f"its standard error ends with: {' | '.join(said)}")
        if self.stdout:
            parts.append(f"on standard output it wrote what is no message: {' | '.join(self.stdout)}")
        return "; ".join(parts)


def environment_of(server: Server) -> dict[str, str]:
    """Return the environment of a server: what is harmless of ours, and what its configuration gives it."""
    # A function of bash is code; nobody needs it here.
    ours = {name: os.environ[name] for name in HARMLESS if not os.environ.get(name, "()").startswith("()")}
    return ours | dict(server.env)


@contextlib.asynccontextmanager
async def stdio_transport(server: Server, remarks: Remarks, max_bytes: int) -> AsyncIterator[Streams]:
    """Run a server and give the streams of messages from and to it.

    Args:
        server: What is started.
        remarks: Filled with what it says on standard error.
        max_bytes: Of a message from it.

    Raises:
        MissingRequirementError: There is no such program, or it cannot be started.
    """
    refuse_windows("an MCP server that is started by a command")
    process = await _started(server)
    to_session, from_server = anyio.create_memory_object_stream[SessionMessage | Exception](0)
    to_server, from_session = anyio.create_memory_object_stream[SessionMessage](0)
    jobs = [
        asyncio.ensure_future(_read(process, to_session, remarks, max_bytes)),
        asyncio.ensure_future(_write(process, from_session, to_session)),
        asyncio.ensure_future(_listen(process, remarks)),
    ]
    try:
        yield from_server, to_server
    finally:
        # A cancelled owner still ends its server; every wait in here is bounded.
        closing = asyncio.ensure_future(_close(process, jobs, [to_session, from_server, to_server, from_session]))
        while not closing.done():
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.shield(closing)
        remarks.exit_code = process.returncode
        closing.result()


async def _started(server: Server) -> asyncio.subprocess.Process:
    environment = environment_of(server)
    found = shutil.which(server.command, path=environment.get("PATH", os.defpath))
    if found is None:
        raise MissingRequirementError(
            f"the MCP server {server.name!r} cannot be started: there is no program {server.command!r}; install it, or "
            "write its whole path"
        )
    if server.cwd is not None and not Path(server.cwd).is_dir():
        raise MissingRequirementError(f"the MCP server {server.name!r} cannot be started: no folder {server.cwd!r}")
    command = [os.path.abspath(found), *server.args]
    if sys.executable and os.name == "posix":
        command = [sys.executable, "-I", "-S", KEEPER, str(os.getpid()), *command]
    try:
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env=environment,
            cwd=server.cwd,
            start_new_session=True,  # Ctrl-C in our terminal is not for it
        )
    except (OSError, ValueError) as error:
        raise MissingRequirementError(f"the MCP server {server.name!r} cannot be started: {error}") from error
    _keepers.add(process.pid)
    return process


async def _read(
    process: asyncio.subprocess.Process,
    to_session: MemoryObjectSendStream[SessionMessage | Exception],
    remarks: Remarks,
    max_bytes: int,
) -> None:
    stdout = _pipe(process.stdout)
    lines = Lines(max_bytes)
    remarks.stdout = lines.stray
    with contextlib.suppress(OSError, anyio.BrokenResourceError, anyio.ClosedResourceError):
        async with to_session:
            while chunk := await stdout.read(_CHUNK):
                for message in lines.feed(chunk):
                    await to_session.send(message)
    # The session is over. What still comes is thrown away, so that the server does not wait for us before it ends.
    while await stdout.read(_CHUNK):
        pass


async def _write(
    process: asyncio.subprocess.Process,
    from_session: MemoryObjectReceiveStream[SessionMessage],
    to_session: MemoryObjectSendStream[SessionMessage | Exception],
) -> None:
    stdin = _pipe(process.stdin)
    try:
        async with from_session:
            async for message in from_session:
                line = message.message.model_dump_json(by_alias=True, exclude_unset=True)
                stdin.write(line.encode() + b"\n")
                await stdin.drain()
    except (OSError, ValueError):
        to_session.close()  # so that nobody waits for the answer


async def _listen(process: asyncio.subprocess.Process, remarks: Remarks) -> None:
    stderr, line = _pipe(process.stderr), b""
    while chunk := await stderr.read(4096):
        *complete, line = (line + chunk).split(b"\n")
        remarks.stderr.extend(text for text in map(shortened, complete) if text)
        line = line[-4096:]
    if text := shortened(line):
        remarks.stderr.append(text)


async def _close(process: asyncio.subprocess.Process, jobs: Sequence[asyncio.Future[None]], streams: list[Any]) -> None:
    for stream in streams:
        stream.close()
    with contextlib.suppress(OSError):
        _pipe(process.stdin).close()
    if not await _ended(process, END_S):
        _signal(process.pid, signal.SIGTERM)
        if not await _ended(process, KILL_S):
            _signal(process.pid, signal.SIGKILL)
            await _ended(process, END_S)
    _keepers.discard(process.pid)
    for job in jobs[2:]:  # the last words on standard error
        await asyncio.wait([job], timeout=0.5)
    for job in jobs:
        job.cancel()
    await asyncio.gather(*jobs, return_exceptions=True)
    transport = getattr(process, "_transport", None)
    if transport is not None:  # asyncio keeps it open, and complains later, where a pipe is held by somebody else
        transport.close()


async def _ended(process: asyncio.subprocess.Process, within_s: float) -> bool:
    # Not process.wait(): that waits for the pipes as well, which a child of the server may hold.
    deadline = time.monotonic() + within_s
    pause = 0.001
    while process.returncode is None:
        if time.monotonic() >= deadline:
            return False
        await asyncio.sleep(pause)
        pause = min(2 * pause, 0.02)
    return True


def _signal(pid: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.kill(pid, number)


def _pipe(stream: Any) -> Any:
    if stream is None:
        raise RuntimeError("a server was started without its standard streams")
    return stream


def _how_it_ended(code: int) -> str:
    if 128 < code < 160:
        code = 128 - code
    if code < 0:
        with contextlib.suppress(ValueError):
            return f"it was ended by {signal.Signals(-code).name}"
    return f"it ended with exit code {code}"


def _end_keepers() -> None:
    """End the servers of whoever did not: the interpreter exits."""
    for pid in _keepers:
        _signal(pid, signal.SIGTERM)


def _after_fork() -> None:
    # A forked child has nothing to do with the servers of its parent.
    _keepers.clear()


atexit.register(_end_keepers)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
