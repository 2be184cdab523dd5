"""The transports over HTTP: the library's, on connections that bound what comes and say what failed.

The library ends the whole session when a server cannot be reached, and says of an error status only that it was one.
Here such a request alone gets an error, whose code tells whether the server may have received it.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any

import httpx2
from mcp.client.sse import sse_client
from mcp.client.streamable_http import streamable_http_client

from gem_tools.mcp.config import SSE, Server

NOT_SENT = -32093
"""Code of our own: the server could not be reached, so it has not received the request."""

LOST = -32094
"""Code of our own: the connection broke; whether the server received the request is unknown."""

REFUSED = -32095
"""Code of our own: the server answered with an HTTP status that says it did not do what was asked."""

SESSION_LOST = -32096
"""Code of our own: the server does not know the session any more, so it has not executed the request."""

_IDLE_S = 7 * 24 * 3600.0
"""For how long a stream may be silent: an episode may think for long. Each request has a time limit of its own."""


@contextlib.asynccontextmanager
async def http_transport(server: Server, connect_s: float, max_bytes: int) -> AsyncIterator[Any]:
    """Connect to a server and give the streams of messages from and to it.

    Args:
        server: Where it is.
        connect_s: Time limit for a connection, in seconds.
        max_bytes: Of a message from it; over the transport ``sse`` the library's own megabyte.
    """
    headers = dict(server.headers)
    timeout = httpx2.Timeout(connect_s, read=_IDLE_S)
    if server.transport == SSE:
        async with sse_client(server.url, headers=headers, timeout=connect_s, sse_read_timeout=_IDLE_S) as streams:
            yield streams
        return
    # Episodes in thousands may ask one server at once.
    limits = httpx2.Limits(max_connections=None, max_keepalive_connections=32)
    async with (
        _Client(max_bytes, headers=headers, timeout=timeout, limits=limits) as client,
        streamable_http_client(server.url, http_client=client, max_sse_event_size=max_bytes) as streams,
    ):
        yield streams


class _Client(httpx2.AsyncClient):
    """A client that answers in the server's place where the server does not, and stops reading at a limit."""

    def __init__(self, max_bytes: int, **options: Any) -> None:
        super().__init__(**options)
        self._max_bytes = max_bytes

    async def send(self, request: httpx2.Request, **options: Any) -> httpx2.Response:
        """Send a request; a fault becomes a response that holds a JSON-RPC error."""
        try:
            response = await super().send(request, **options)
        except (httpx2.ConnectError, httpx2.ConnectTimeout, httpx2.PoolTimeout) as error:
            return _failed(request, 503, NOT_SENT, f"the server cannot be reached ({_words(error)})")
        except httpx2.TransportError as error:
            return _failed(request, 503, LOST, f"the connection broke ({_words(error)})")
        if response.status_code < 400:
            # An event stream has the library's own limit, for each event.
            if not response.headers.get("content-type", "").lower().startswith("text/event-stream"):
                response.stream = _Bounded(response.stream, self._max_bytes)
            return response
        if response.status_code == 404 and "mcp-session-id" in request.headers:
            await response.aclose()
            return _failed(request, 404, SESSION_LOST, "the server does not know the session any more")
        if response.headers.get("content-type", "").lower().startswith("application/json"):
            with contextlib.suppress(httpx2.HTTPError, httpx2.StreamError, ValueError, RecursionError):
                response.stream = _Bounded(response.stream, self._max_bytes)
                answer = json.loads(await response.aread())
                if isinstance(answer, dict) and isinstance(answer.get("error"), dict):
                    return response
        await response.aclose()
        status = f"{response.status_code} {response.reason_phrase}".strip()
        return _failed(request, response.status_code, REFUSED, f"the server answered with status {status}")


class _Bounded(httpx2.AsyncByteStream):
    """A body that ends in an error where it grows too long."""

    def __init__(self, inner: Any, max_bytes: int) -> None:
        self._inner, self._max_bytes = inner, max_bytes

    async def __aiter__(self) -> AsyncIterator[bytes]:
        length = 0
        async for chunk in self._inner:
            length += len(chunk)
            if length > self._max_bytes:
                raise httpx2.StreamError(f"the answer is over {self._max_bytes:,} bytes long")
            yield chunk

    async def aclose(self) -> None:
        await self._inner.aclose()


def _failed(request: httpx2.Request, status: int, code: int, message: str) -> httpx2.Response:
    # The library puts the request's own id in place of the null.
    error = {"jsonrpc": "2.0", "id": None, "error": {"code": code, "message": message}}
    return httpx2.Response(status, json=error, request=request)


def _words(error: Exception) -> str:
    """Return what went wrong, without the address that some messages hold."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.strerror:
            return cause.strerror
        cause = cause.__cause__ or cause.__context__
    return type(error).__name__
