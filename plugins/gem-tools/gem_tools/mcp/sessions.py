"""What an episode, or all episodes of a process, have of one server: a connection that is made anew when it is lost."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
import weakref
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gem_core.background import background_loop
from gem_core.errors import GemError
from gem_tools.mcp.config import STDIO
from gem_tools.mcp.connection import Connection, Limits, ServerFault
from gem_tools.mcp.listing import forget, paged

if TYPE_CHECKING:
    from gem_tools.mcp.config import Server

logger = logging.getLogger("gem_tools.mcp")

MAX_RESTARTS = 3
"""Starts or connections in a row without anything done of what was asked; then a server is left alone for a while."""

FIRST_PAUSE_S, COOL_DOWN_S = 0.1, 30.0


class ServerSession:
    """A connection to a server that outlives the server.

    Args:
        server: The server.
        limits: Time limits and sizes.
        roots: Folders that it is told to work in.
    """

    def __init__(self, server: Server, limits: Limits, roots: Sequence[str] = ()) -> None:
        self.server, self.limits, self.roots = server, limits, roots
        self.generation = 0
        """How many connections there have been."""
        self._connection: Connection | None = None
        self._connecting = asyncio.Lock()
        self._in_vain = 0
        self._last_start = 0.0
        self._closed = False
        self._process = os.getpid()

    async def request(self, method: str, params: Mapping[str, Any], *, repeatable: bool = False) -> dict[str, Any]:
        """Send a request; connect first where there is no connection.

        A request that the server has surely not received is sent once more, over a new connection; one that it may have
        received only where that does no harm.

        Args:
            method: The protocol's name for it.
            params: Its parameters, plain JSON.
            repeatable: Whether doing it twice does no harm.

        Raises:
            ServerFault: No result.
            GemError: The server cannot be started.
        """
        for again in (True, False):
            connection = await self._connected()
            try:
                result = await connection.request(method, params, self.limits.call_s)
            except ServerFault as fault:
                if fault.kind in ("died", "unreachable", "deaf"):
                    await self._drop(connection)
                if fault.kind in ("error", "protocol", "too_long"):
                    self._in_vain = 0  # it answers
                if not again or not (not fault.sent or (repeatable and fault.kind == "died")):
                    raise
            else:
                self._in_vain = 0
                return result
        raise AssertionError("unreachable")

    async def listed(self, method: str, key: str) -> list[Any]:
        """Return a list of the server's, all pages.

        Raises:
            ServerFault: No list.
        """
        for again in (True, False):
            connection = await self._connected()
            try:
                return await paged(connection, method, key)
            except ServerFault as fault:
                if fault.kind in ("died", "unreachable", "deaf"):
                    await self._drop(connection)
                if not again or fault.kind not in ("died", "unreachable"):
                    raise
        raise AssertionError("unreachable")

    async def close(self) -> None:
        """Close the connection, for good."""
        self._leave_to_parent()
        self._closed = True
        connection, self._connection = self._connection, None
        if connection is not None:
            await connection.close()

    async def _connected(self) -> Connection:
        self._leave_to_parent()
        async with self._connecting:
            if self._closed:
                raise ServerFault("unreachable", "the session is closed", sent=False)
            if self._connection is not None:
                if self._connection.alive:
                    return self._connection
                await self._drop(self._connection)
            await self._pause()
            connection = Connection(self.server, self.limits, self.roots, lambda: forget(self.server))
            self._in_vain += 1
            self._last_start = asyncio.get_running_loop().time()
            await connection.open()
            self._connection = connection
            self.generation += 1
            return connection

    def _leave_to_parent(self) -> None:
        """In a forked child: go on without the connection, whose loop and server are the parent's."""
        if self._process == os.getpid():
            return
        if self._connection is not None:
            _of_parent.append(self._connection)
        self._connection, self._connecting, self._process = None, asyncio.Lock(), os.getpid()

    async def _pause(self) -> None:
        if self._in_vain == 0 and self.generation == 0:
            return
        since = asyncio.get_running_loop().time() - self._last_start
        if self._in_vain > MAX_RESTARTS and since < COOL_DOWN_S:
            event = "started" if self.server.transport == STDIO else "connected to"
            message = (
                f"it was {event} {self._in_vain} times in a row without doing what was asked, and is left alone for "
                f"{COOL_DOWN_S:g} s"
            )
            raise ServerFault("unreachable", message, sent=False)
        await asyncio.sleep(FIRST_PAUSE_S * 2 ** min(self._in_vain, MAX_RESTARTS))

    async def _drop(self, connection: Connection) -> None:
        if self._connection is connection:
            self._connection = None
        try:
            await connection.close()
        except Exception:
            logger.warning("gem: closing a connection to the MCP server %r failed", self.server.name, exc_info=True)


class Handle:
    """What one episode has of a session, which may be shared: it knows which connection the episode last saw.

    Args:
        session: The session.
        shared: Whether others use it as well; then it is not closed with the handle.
    """

    def __init__(self, session: ServerSession, shared: bool) -> None:
        self.session, self.shared = session, shared
        self._seen: int | None = None

    def restarted(self) -> bool:
        """Tell, once, whether the connection is another than at the episode's last call."""
        before, self._seen = self._seen, self.session.generation
        return before is not None and before != self._seen

    async def close(self) -> None:
        """Close the session, unless others use it."""
        if not self.shared:
            await self.session.close()


_of_parent: list[object] = []
"""What a forked child must not even collect: pipes that are closed here are lost to the parent's event loop, too."""

_lock = threading.Lock()
_shared: dict[tuple[Any, ...], tuple[ServerSession, set[int]]] = {}


def shared_session(user: object, server: Server, limits: Limits, roots: Sequence[str]) -> ServerSession:
    """Return the process's one session with a server; it is closed when all of its users are gone.

    Args:
        user: Who uses it, for as long as it exists.
        server: The server.
        limits: Time limits and sizes.
        roots: Folders that it is told to work in.
    """
    key = (server, limits, tuple(roots), os.getpid())
    with _lock:
        session, users = _shared.setdefault(key, (ServerSession(server, limits, roots), set()))
        if id(user) not in users:
            users.add(id(user))
            weakref.finalize(user, _release, key, id(user))
        return session


def _release(key: tuple[Any, ...], user: int) -> None:
    # This may be the garbage collector, in any thread, at any point: it neither waits nor takes the lock.
    if key[-1] == os.getpid():
        background_loop().call_soon_threadsafe(_released, key, user)


def _released(key: tuple[Any, ...], user: int) -> None:
    with _lock:
        session, users = _shared.get(key, (None, set()))
        users.discard(user)
        if session is None or users:
            return
        del _shared[key]
    _closing.add(asyncio.ensure_future(_closed(session)))


_closing: set[asyncio.Task[None]] = set()


async def _closed(session: ServerSession) -> None:
    try:
        await session.close()
    except GemError:
        logger.debug("closing a shared session failed", exc_info=True)
    finally:
        task = asyncio.current_task()
        if task is not None:
            _closing.discard(task)


def _after_fork() -> None:
    global _lock
    _lock = threading.Lock()
    _of_parent.extend([*_shared.values(), *_closing])
    _shared.clear()
    _closing.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
