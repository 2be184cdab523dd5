"""The library's transports to servers that are not to be trusted: a limit of bytes for each message, and what they say.

A server over stdio is started by the library, which ends it with the group of its processes.
"""

from __future__ import annotations

import codecs
import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import AsyncIterator
from typing import Any

import httpx2
from mcp import StdioServerParameters, stdio_client
from mcp.client.sse import sse_client
from mcp.client.streamable_http import streamable_http_client

from gem_core.errors import MissingRequirementError, refuse_windows
from gem_tools.mcp.config import SSE, STDIO, Server
from gem_tools.mcp.text import shortened

HARMLESS = ("LANG", "LC_ALL", "LC_CTYPE", "TMPDIR", "TZ")
"""Variables of our environment that every server gets besides the library's own list (``PATH``, ``HOME`` …)."""

MAX_MESSAGE_BYTES = 10_000_000
TOO_LONG = f"the answer is over {MAX_MESSAGE_BYTES:,} bytes long"

_IDLE_S = 7 * 24 * 3600.0
"""For how long a stream may be silent: an episode may think for long. Each request has a time limit of its own."""

_HALF = re.compile(r"\\u[dD][89abAB]\w\w\\u[dD][c-fC-F]\w\w|(\\u[dD][89a-fA-F]\w\w)|\\.")
"""An escape in JSON; with a group if it is half of a character, for which the library drops the whole message."""


class Remarks:
    """What a server says besides messages, kept for when something goes wrong."""

    def __init__(self) -> None:
        self.stderr = tempfile.TemporaryFile("w+b")  # noqa: SIM115 - as long as the connection
        self.stray = ""
        """The last line on standard output that was no message."""
        self.status = ""
        """The last HTTP status that said that something was wrong."""
        self._last_lines: list[str] = []

    def __str__(self) -> str:
        self._read()
        parts = [f"its standard error ends with: {' | '.join(self._last_lines)}"] if self._last_lines else []
        parts += [f"on standard output it wrote what is no message: {self.stray}"] if self.stray else []
        return "; ".join(parts)

    def close(self) -> None:
        """Keep the end of what was written to standard error, and remove the file."""
        self._read()
        self.stderr.close()

    def _read(self) -> None:
        if not self.stderr.closed:
            self.stderr.seek(max(0, self.stderr.seek(0, os.SEEK_END) - 4096))
            lines = self.stderr.read().decode(errors="replace").splitlines()
            self._last_lines = [shortened(line) for line in lines if line.strip()][-5:]


def transport(server: Server, remarks: Remarks) -> Any:
    """Return a context manager that connects to a server and gives the streams of messages from and to it."""
    if server.transport == STDIO:
        return _stdio(server, remarks)
    if server.transport == SSE:  # which has the library's own limit of a megabyte
        return sse_client(server.url, headers=dict(server.headers), timeout=server.connect_s, sse_read_timeout=_IDLE_S)
    return _http(server, remarks)


# Standard input and output.


@contextlib.asynccontextmanager
async def _stdio(server: Server, remarks: Remarks) -> AsyncIterator[Any]:
    refuse_windows("an MCP server that is started by a command")
    cannot = f"the MCP server {server.name!r} cannot be started:"
    environment = {name: os.environ[name] for name in HARMLESS if name in os.environ} | dict(server.env)
    program = shutil.which(server.command, path=environment.get("PATH"))
    if program is None:
        message = f"{cannot} there is no program {server.command!r}; install it, or write its whole path"
        raise MissingRequirementError(message)
    started = StdioServerParameters(
        command=os.path.abspath(program),
        args=list(server.args),
        env=environment,
        cwd=server.cwd,
        encoding=BOUNDED_UTF8,
    )
    async with contextlib.AsyncExitStack() as stack:
        try:
            streams = await stack.enter_async_context(stdio_client(started, errlog=remarks.stderr))  # type: ignore[arg-type]
        except (OSError, ValueError) as error:
            raise MissingRequirementError(f"{cannot} {error}") from error
        yield streams


class BoundedLines(codecs.IncrementalDecoder):
    """Decodes UTF-8 leniently into whole lines, which the library's client would put together without a limit."""

    max_chars = MAX_MESSAGE_BYTES

    def __init__(self, errors: str = "strict") -> None:
        super().__init__(errors)
        self._utf8 = codecs.getincrementaldecoder("utf-8")("replace")
        self._rest = ""

    def decode(self, data: Any, final: bool = False) -> str:
        """Return the lines that some bytes end; in the place of one that is too long, that it is."""
        lines = (self._rest + self._utf8.decode(data, final)).split("\n")
        if max(map(len, lines)) > self.max_chars:
            self._rest = ""
            return f"{TOO_LONG}\n"  # no message: the connection gives up
        self._rest = lines.pop()
        return "".join(_HALF.sub(lambda found: r"\ufffd" if found[1] else found[0], line) + "\n" for line in lines)


BOUNDED_UTF8 = "gem_mcp_lines"
"""The name of an encoding: UTF-8 whose lines are bounded when they are read."""

_utf8 = codecs.lookup("utf-8")
_codec = codecs.CodecInfo(_utf8.encode, _utf8.decode, incrementaldecoder=BoundedLines, name=BOUNDED_UTF8)
codecs.register({BOUNDED_UTF8: _codec}.get)


# HTTP.


@contextlib.asynccontextmanager
async def _http(server: Server, remarks: Remarks) -> AsyncIterator[Any]:
    async def look(response: httpx2.Response) -> None:
        if response.status_code >= 400:
            remarks.status = f"{response.status_code} {response.reason_phrase}".strip()
        # An event stream has the library's own limit, for each event.
        if not response.headers.get("content-type", "").lower().startswith("text/event-stream"):
            response.stream = _BoundedBody(response.stream)

    async with (
        httpx2.AsyncClient(
            headers=dict(server.headers),
            timeout=httpx2.Timeout(server.connect_s, read=_IDLE_S),
            # Episodes in thousands may ask one server at once.
            limits=httpx2.Limits(max_connections=None, max_keepalive_connections=32),
            event_hooks={"response": [look]},
        ) as client,
        streamable_http_client(server.url, http_client=client, max_sse_event_size=MAX_MESSAGE_BYTES) as streams,
    ):
        yield streams


class _BoundedBody(httpx2.AsyncByteStream):
    """A body that ends in an error if it grows too long."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner

    async def __aiter__(self) -> AsyncIterator[bytes]:
        length = 0
        async for chunk in self._inner:
            length += len(chunk)
            if length > MAX_MESSAGE_BYTES:
                raise httpx2.StreamError(TOO_LONG)
            yield chunk

    async def aclose(self) -> None:
        await self._inner.aclose()
