"""One connection to one server: opened, used and closed on one event loop, by a task that owns it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from typing import Any

from mcp import ClientSession, MCPError
from mcp.shared.jsonrpc_dispatcher import JSONRPCDispatcher
from mcp.types import (
    CONNECTION_CLOSED,
    METHOD_NOT_FOUND,
    UNSUPPORTED_PROTOCOL_VERSION,
    Implementation,
    Request,
)
from pydantic import TypeAdapter, ValidationError

from gem_core import __version__
from gem_core.errors import GemError
from gem_tools.mcp.config import STDIO, Server
from gem_tools.mcp.text import shortened
from gem_tools.mcp.transports import TOO_LONG, Remarks, transport

# Without a handler, Python prints what the library logs of every misbehaving server on standard error. Whoever
# configures logging still gets it.
for _name in ("mcp", "client"):
    logging.getLogger(_name).addHandler(logging.NullHandler())

_OBJECT: TypeAdapter[dict[str, Any]] = TypeAdapter(dict[str, Any])
_CLOSE_S = 15.0
"""Longer than closing a transport may take; after that its task is cancelled."""

_owners: set[asyncio.Task[None]] = set()
"""Tasks that own a connection; a loop keeps only weak references to its tasks."""


class ServerFault(GemError):
    """A server that gave no result.

    Args:
        kind: ``"unreachable"`` (it did not receive the request), ``"timeout"``, ``"died"`` (the connection is
            lost), ``"error"`` (a JSON-RPC error), ``"too_long"`` (the answer) or ``"protocol"``.
        message: What happened.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class Connection:
    """A session with a server, for any number of requests at once, on the event loop that ``open`` was awaited on."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.has_tools = False
        self._remarks = Remarks()
        self._session: ClientSession | None = None
        self._modern = False
        self._owner: asyncio.Task[None] | None = None
        self._stop, self._ready = asyncio.Event(), asyncio.Event()
        self._cause: BaseException | None = None
        self._refusal = ""

    @property
    def alive(self) -> bool:
        """Whether requests can be sent."""
        return self._session is not None and not self._stop.is_set()

    async def open(self) -> None:
        """Connect, and shake hands; raise a GemError if that fails."""
        self._owner = asyncio.ensure_future(self._own())
        _owners.add(self._owner)
        self._owner.add_done_callback(_owners.discard)
        try:
            async with asyncio.timeout(self.server.connect_s):
                await self._ready.wait()
        except TimeoutError:
            self._cause = self._cause or TimeoutError()
        finally:
            if self._session is None:
                await self.close()
        if self._session is None:
            raise self._opening_fault()

    async def request(self, method: str, params: Mapping[str, Any], timeout_s: float) -> dict[str, Any]:
        """Send a request and return its result, as the server wrote it; raise a ServerFault if there is none.

        On a timeout the server is told that nobody waits any more, and the session goes on.
        """
        if not self.alive:
            raise await self._death()
        try:
            # This clock and no other: an error of a server may look as one of the library's clock.
            async with asyncio.timeout(timeout_s):
                return await self._send(method, dict(params))
        except TimeoutError:
            raise ServerFault("timeout", f"it did not answer within {timeout_s:g} s") from None
        except MCPError as error:
            raise await self._fault(error) from None
        except (ValidationError, RuntimeError, ValueError) as error:
            message = f"the answer is not of the protocol's form: {self._shown(str(error))}"
            raise ServerFault("protocol", message) from None

    def stop(self) -> None:
        """Let the connection be closed, without waiting for it."""
        self._stop.set()

    async def close(self) -> None:
        """Close the session, and end a server that was started here. Harmless when repeated."""
        self._stop.set()
        if self._owner is None:
            return
        try:
            await asyncio.wait({self._owner}, timeout=_CLOSE_S if self._ready.is_set() else 0)
        finally:
            self._owner.cancel()
        await asyncio.wait({self._owner}, timeout=_CLOSE_S)

    def said(self) -> str:
        """Return what the server said besides messages; nothing if there is nothing."""
        return self.server.without_secrets(str(self._remarks))

    async def _own(self) -> None:
        try:
            async with transport(self.server, self._remarks) as (reading, writing):
                self._dispatcher = JSONRPCDispatcher(reading, writing)
                session = ClientSession(
                    dispatcher=self._dispatcher,
                    client_info=Implementation(name="gem", version=__version__),
                    message_handler=self._notice,
                )
                async with session:
                    await self._shake_hands(session)
                    self._session = session
                    self._ready.set()
                    await self._stop.wait()
        except asyncio.CancelledError:
            pass
        except (Exception, BaseExceptionGroup) as error:  # noqa: BLE001 - whoever asks next is told
            self._cause = error
            while isinstance(self._cause, BaseExceptionGroup):
                self._cause = self._cause.exceptions[0]
        finally:
            self._session = None
            self._remarks.close()
            self._ready.set()

    async def _shake_hands(self, session: ClientSession) -> None:
        # Every server of today answers `initialize`, those of before 2026 nothing else; a newer one names its versions.
        try:
            await session.initialize()
        except MCPError as error:
            if error.code not in (UNSUPPORTED_PROTOCOL_VERSION, METHOD_NOT_FOUND):
                self._refusal = "" if self._lost(error) else error.message
                raise
            await session.discover()
            self._modern = True
        self.has_tools = session.server_capabilities is not None and session.server_capabilities.tools is not None

    async def _send(self, method: str, params: dict[str, Any]) -> dict[str, Any]:
        if self._modern and self._session is not None:
            answer: Any = _OBJECT  # the annotation knows of models alone
            asked = Request[dict[str, Any], str](method=method, params=params)
            return await self._session.send_request(asked, answer)  # type: ignore[no-any-return]
        # Not through the session: one tool that is malformed would cost the whole list, and the session holds results
        # to output schemas in ways that a hostile one can draw out for ever.
        return await self._dispatcher.send_raw_request(method, params)

    async def _notice(self, message: object) -> None:
        if isinstance(message, ValidationError):
            self._remarks.stray = shortened(str(message.errors()[0]["input"]))
            if self._remarks.stray == TOO_LONG:  # nobody knows which answer it was
                self.stop()

    # What went wrong.

    def _lost(self, error: MCPError) -> bool:
        """Tell whether an error is that messages have ended: all, or over HTTP those that would answer the request."""
        closed = error.code == CONNECTION_CLOSED and error.message == "Connection closed"
        return closed or (self.server.transport != STDIO and error.message.startswith("SSE stream "))

    async def _fault(self, error: MCPError) -> ServerFault:
        message = self._shown(error.message) or "no reason given"
        if self._lost(error):
            return await self._death()
        if TOO_LONG in message:
            return ServerFault("too_long", TOO_LONG)
        if self.server.transport != STDIO:
            if message == "Session terminated":
                self.stop()
                return ServerFault("unreachable", "the server does not know the session any more")
            if message.startswith("Failed to parse "):
                return ServerFault("protocol", message)
        return ServerFault("error", message)

    async def _death(self) -> ServerFault:
        await self.close()  # to learn why
        if self._remarks.stray == TOO_LONG:
            return ServerFault("too_long", TOO_LONG)
        ended = "the server has ended" if self.server.transport == STDIO else "the connection broke"
        said = self.said() if self.server.transport == STDIO else self._cause and self._words()
        return ServerFault("died", f"{ended} ({said})" if said else ended)

    def _opening_fault(self) -> GemError:
        cause = self._cause
        if isinstance(cause, GemError):
            return cause
        if isinstance(cause, TimeoutError):
            text = f"did not answer within {self.server.connect_s:g} s; give it more with connect_timeout_s"
        elif self._refusal:
            text = f"refused the connection: {self._shown(self._refusal)}"
        elif self.server.transport == STDIO:
            text = "ended before it had answered"
        else:
            text = f"cannot be used: {self._words()}"
        said = self.said()
        message = f"the MCP server {self.server.name!r} ({self.server.place}) {text}{f'; {said}' if said else ''}"
        return ServerFault("unreachable", message)

    def _shown(self, message: str) -> str:
        if message == "Server returned an error response" and self._remarks.status:
            message = f"the server answered with status {self._remarks.status}"
        return shortened(self.server.without_secrets(message), 2000)

    def _words(self) -> str:
        """Return what ended the connection, without the address that some messages hold."""
        cause = self._cause
        while cause is not None:
            if isinstance(cause, OSError) and cause.strerror:
                return cause.strerror
            cause = cause.__cause__ or cause.__context__
        return "the connection was closed" if self._cause is None else type(self._cause).__name__
