"""A server as an episode, or all episodes of a process, use it: connected anew when the connection is lost."""

from __future__ import annotations

import asyncio
import os
import shutil
import tempfile
import weakref
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from gem_core.background import background_loop
from gem_core.errors import StateNotSupported
from gem_tools.mcp.connection import Connection

if TYPE_CHECKING:
    from gem_tools.mcp.config import Server


class ServerSession:
    """Connects to a server at the first request, and again at the next one after the connection is lost."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.generation = 0
        """How many connections there have been."""
        self._begin()

    def _begin(self) -> None:
        self._process = os.getpid()
        self._connecting = asyncio.Lock()
        self._open: list[Connection] = []  # the connection, where there is one
        self._folders: list[str] = []  # what ``{episode_dir}`` stands for, where it was made
        # When nobody refers to the session any more:
        weakref.finalize(self, _stop, self._open, self._folders, self._process)

    async def request(self, method: str, params: Mapping[str, Any]) -> dict[str, Any]:
        """Send a request, once; connect first where there is no connection. Raises as ``Connection`` does."""
        if self._process != os.getpid():
            self._begin()  # in a forked child, whose parent goes on with the connection
        async with self._connecting:
            if not self._open or not self._open[0].alive:
                await self._disconnect()
                if self.server.in_folder(".") != self.server and not self._folders:
                    self._folders.append(tempfile.mkdtemp(prefix="gem-mcp-"))
                connection = Connection(self.server.in_folder(*self._folders) if self._folders else self.server)
                await connection.open()
                self._open.append(connection)
                self.generation += 1
            connection = self._open[0]
        return await connection.request(method, params, self.server.call_s)

    async def close(self) -> None:
        """Close the connection, and delete the folder of the session."""
        await self._disconnect()
        while self._process == os.getpid() and self._folders:
            shutil.rmtree(self._folders.pop(), ignore_errors=True)

    async def _disconnect(self) -> None:
        while self._process == os.getpid() and self._open:
            await self._open.pop().close()


class Handle:
    """The session that one episode uses, which may be shared; it knows which connection the episode last saw."""

    def __init__(self, session: ServerSession, shared: bool) -> None:
        self.session, self.shared = session, shared
        self._seen: int | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> Handle:
        raise StateNotSupported(
            f"the state of the MCP server {self.session.server.name!r} cannot be copied; make another environment, "
            "reset it with the same seed and options, and repeat the actions"
        )

    def restarted(self) -> bool:
        """Tell, once, whether the connection is another than at the episode's last call."""
        before, self._seen = self._seen, self.session.generation
        return before is not None and before != self._seen

    async def close(self) -> None:
        """Close the session, unless others use it."""
        if not self.shared:
            await self.session.close()


_shared: weakref.WeakValueDictionary[tuple[Server, int], ServerSession] = weakref.WeakValueDictionary()


def shared_session(server: Server) -> ServerSession:
    """Return the process's one session with a server, for as long as someone refers to it."""
    session = _shared.get((server, os.getpid()))
    if session is None:
        session = _shared[server, os.getpid()] = ServerSession(server)
    return session


def _stop(connections: list[Connection], folders: list[str], process: int) -> None:
    # This may be the garbage collector, in any thread, at any point; or a forked child of the process.
    if process == os.getpid():
        for connection in connections:
            background_loop().call_soon_threadsafe(connection.stop)
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)
