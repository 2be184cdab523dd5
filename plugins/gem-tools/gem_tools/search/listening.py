"""Listening for requests, so that nobody can take all of a server's connections by saying nothing."""

from __future__ import annotations

import asyncio
from typing import Any

from aiohttp import web

HEADERS_S = 20.0
"""A connection that has brought no request by then is closed."""

KEEP_ALIVE_S = 75.0
"""A connection that has been answered may be idle for so long."""

MOST_CONNECTIONS = 16_384

_BACKLOG = 64
_OTHER_FILES = 5 * _BACKLOG
"""Files that are kept back: an index has some, and asyncio takes a few backlogs of connections before it closes one."""


class Listener:
    """Listens on a port, with a bound on connections and on how long one may say nothing.

    Beyond the system's limit of open files, asyncio would write a traceback for each connection that it cannot take,
    and take none any more.

    Args:
        app: Answers the requests.
        shutdown_s: How long requests may take that are under way when the listener is closed, in seconds.
        most: Connections at once; by default as many as the system's limit of open files leaves room for.
    """

    def __init__(self, app: web.Application, *, shutdown_s: float, most: int | None = None) -> None:
        app.middlewares.append(self._hear)
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=shutdown_s, keepalive_timeout=KEEP_ALIVE_S)
        self._most = most or _room()
        self._silent: set[Any] = set()
        self._server: asyncio.Server | None = None

    async def open(self, host: str, port: int) -> int:
        """Begin to listen, and return the port.

        Raises:
            OSError: The port is taken, or the address is not this machine's.
        """
        await self._runner.setup()
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(self._connected, host, port, backlog=_BACKLOG)
        bound: int = self._server.sockets[0].getsockname()[1]
        return bound

    async def close(self) -> None:
        """Take no more connections, and answer what is under way."""
        if self._server is not None:
            self._server.close()
        await self._runner.cleanup()

    def _connected(self) -> asyncio.BaseProtocol:
        server: Any = self._runner.server
        if len(server.connections) >= self._most:
            return _Full()
        connection: asyncio.BaseProtocol = server()
        self._silent.add(connection)
        asyncio.get_running_loop().call_later(HEADERS_S, self._give_up, connection)
        return connection

    def _give_up(self, connection: Any) -> None:
        if connection in self._silent:
            self._silent.discard(connection)
            connection.force_close()

    @web.middleware
    async def _hear(self, request: web.Request, handler: Any) -> web.StreamResponse:
        self._silent.discard(request.protocol)
        response: web.StreamResponse = await handler(request)
        return response


class _Full(asyncio.Protocol):
    """Hangs up, since there is no place for another connection."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.close()


def _room() -> int:
    """Return how many connections may be open, with as many open files as the system grants."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return MOST_CONNECTIONS
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_CONNECTIONS + _OTHER_FILES
    if soft != resource.RLIM_INFINITY and soft < wanted:
        soft = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return MOST_CONNECTIONS if soft == resource.RLIM_INFINITY else max(1, min(MOST_CONNECTIONS, soft - _OTHER_FILES))
