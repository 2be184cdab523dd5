"""One connection to one server: opened, used and closed on one event loop, by a task that owns it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcp import ClientSession, MCPError
from mcp.shared.jsonrpc_dispatcher import JSONRPCDispatcher
from mcp.types import (
    CONNECTION_CLOSED,
    METHOD_NOT_FOUND,
    REQUEST_TIMEOUT,
    UNSUPPORTED_PROTOCOL_VERSION,
    Implementation,
    ListRootsResult,
    Request,
    ToolListChangedNotification,
)
from pydantic import TypeAdapter, ValidationError

from gem_core.errors import GemError
from gem_tools.mcp.config import STDIO, Server
from gem_tools.mcp.messages import TOO_LONG, UNREADABLE, shortened
from gem_tools.mcp.stdio import Remarks, stdio_transport
from gem_tools.mcp.web import LOST, NOT_SENT, SESSION_LOST, http_transport

if TYPE_CHECKING:
    from mcp.client.session import ClientRequestContext

# Without a handler, Python prints what the library logs of every misbehaving server on standard error. Whoever
# configures logging still gets it.
for _name in ("mcp", "client"):
    logging.getLogger(_name).addHandler(logging.NullHandler())

_OBJECT: TypeAdapter[dict[str, Any]] = TypeAdapter(dict[str, Any])
_CLOSE_S = 15.0
"""Longer than closing a transport may take; after that the owner is cancelled."""


@dataclass(frozen=True)
class Limits:
    """What a server is given, in seconds and bytes.

    Args:
        connect_s: For its start and its first answer.
        list_s: For the lists of its tools, resources and prompts, all pages together.
        call_s: For a call.
        max_bytes: For a message from it.
    """

    connect_s: float = 30.0
    list_s: float = 30.0
    call_s: float = 60.0
    max_bytes: int = 10_000_000


class ServerFault(GemError):
    """A server that did not answer, and what is known of the request.

    Args:
        kind: ``"unreachable"``, ``"timeout"``, ``"deaf"`` (it does not take requests any more), ``"died"``, ``"error"``
            (a JSON-RPC error), ``"too_long"`` (the answer) or ``"protocol"``.
        message: What happened.
        sent: Whether the server may have received the request.
        code: The JSON-RPC error's.
    """

    def __init__(self, kind: str, message: str, *, sent: bool = True, code: int | None = None) -> None:
        super().__init__(message)
        self.kind, self.message, self.sent, self.code = kind, message, sent, code


class Connection:
    """A session with a server.

    All of its methods are for the event loop that ``open`` was awaited on. Any number of requests may be under way.

    Args:
        server: The server.
        limits: Time limits and sizes.
        roots: Folders that the server is told to work in, where it asks.
        on_tools_changed: Called when the server says that its tools are others now.
    """

    def __init__(
        self,
        server: Server,
        limits: Limits,
        roots: Sequence[str] = (),
        on_tools_changed: Callable[[], None] | None = None,
    ) -> None:
        self.server, self.limits = server, limits
        self.capabilities: dict[str, Any] = {}
        self.info: dict[str, Any] = {}
        self.remarks = Remarks()
        self._roots = roots
        self._on_tools_changed = on_tools_changed
        self._session: ClientSession | None = None
        self._dispatcher: JSONRPCDispatcher[Any] | None = None
        self._modern = False
        self._owner: asyncio.Task[None] | None = None
        self._stop, self._ended = asyncio.Event(), asyncio.Event()
        self._ready: asyncio.Future[None] | None = None
        self._cause: BaseException | None = None

    @property
    def alive(self) -> bool:
        """Whether requests can be sent."""
        return self._session is not None and not self._ended.is_set()

    async def open(self) -> None:
        """Connect, and shake hands.

        Raises:
            ServerFault: The server cannot be started or reached, or does not speak the protocol.
            GemError: There is no such program.
        """
        self._ready = asyncio.get_running_loop().create_future()
        self._owner = asyncio.ensure_future(self._own())
        try:
            await asyncio.wait({self._owner, self._ready}, timeout=self.limits.connect_s, return_when="FIRST_COMPLETED")
        except asyncio.CancelledError:
            await self.close()
            raise
        if self._ready.done() and self._owner is not None and not self._owner.done():
            return
        timed_out = not self._owner.done()
        await self.close()
        raise self._opening_fault(timed_out)

    async def request(self, method: str, params: Mapping[str, Any], timeout_s: float) -> dict[str, Any]:
        """Send a request and return its result, as the server wrote it.

        On a timeout the server is told that nobody waits any more; the session stays usable.

        Raises:
            ServerFault: No result; it says why, and whether the server may have received the request.
        """
        if not self.alive:
            raise ServerFault("died", self.death(), sent=False)
        try:
            # The library's clock starts once the request is written; a server that reads nothing is met by the outer.
            async with asyncio.timeout(timeout_s + 1):
                return await self._send(method, dict(params), timeout_s)
        except MCPError as error:
            if error.code == CONNECTION_CLOSED and self._ended.is_set():
                raise ServerFault("died", await self._last_words()) from None
            raise _fault(error, self.server.blotted(error.message), timeout_s) from None
        except TimeoutError:
            raise ServerFault("deaf", f"it did not even take the request within {timeout_s:g} s") from None
        except (ValidationError, RuntimeError, ValueError) as error:
            message = f"the answer is not of the protocol's form: {shortened(self.server.blotted(str(error)))}"
            raise ServerFault("protocol", message) from None

    async def close(self) -> None:
        """Close the session; a server that was started is ended, with all that it started. Harmless when repeated."""
        owner = self._owner
        if owner is None:
            return
        self._stop.set()
        try:
            done, _ = await asyncio.wait({owner}, timeout=0 if self._ready and not self._ready.done() else _CLOSE_S)
            if not done:
                owner.cancel()
                await asyncio.wait({owner}, timeout=_CLOSE_S)
        except asyncio.CancelledError:
            owner.cancel()
            raise

    def death(self) -> str:
        """Return how the server went, in words."""
        if self.server.transport == STDIO:
            said = self.said()
            return f"the server has ended ({said})" if said else "the server has ended"
        why = "" if self._cause is None else f" ({self.server.blotted(_words(_innermost(self._cause)))})"
        return f"the connection to the server has ended{why}"

    def said(self) -> str:
        """Return what the server said besides messages, and how it ended, in words; nothing where there is nothing."""
        return self.server.blotted(str(self.remarks))

    async def _last_words(self) -> str:
        # The owner closes the transport now, and learns the exit code.
        if self._owner is not None:
            await asyncio.wait({self._owner}, timeout=_CLOSE_S)
        return self.death()

    def _opening_fault(self, timed_out: bool) -> GemError:
        cause = _innermost(self._cause)
        if isinstance(cause, GemError):
            return cause
        if timed_out:
            text = f"did not answer within {self.limits.connect_s:g} s; give it more with connect_timeout_s"
        elif isinstance(cause, MCPError) and cause.code != CONNECTION_CLOSED:
            text = f"refused the connection: {shortened(self.server.blotted(cause.message), 500)}"
        elif self.server.transport == STDIO:
            text = "ended before it had answered"
        else:
            text = f"cannot be used: {self.server.blotted(_words(cause))}"
        said = self.said()
        message = f"the MCP server {self.server.name!r} ({self.server.place}) {text}{f'; {said}' if said else ''}"
        return ServerFault("timeout" if timed_out else "unreachable", message, sent=False)

    async def _own(self) -> None:
        try:
            async with self._transport() as (reading, writing):
                self._dispatcher = JSONRPCDispatcher(_Watched(reading, self._ended), writing)
                session = ClientSession(
                    dispatcher=self._dispatcher,
                    client_info=Implementation(name="gem", version=_version()),
                    list_roots_callback=self._list_roots if self._roots else None,
                    message_handler=self._notice,
                )
                async with session:
                    await self._shake_hands(session)
                    self._session = session
                    if self._ready is not None and not self._ready.done():
                        self._ready.set_result(None)
                    await _first(self._stop, self._ended)
        except asyncio.CancelledError:
            pass
        except (Exception, BaseExceptionGroup) as error:  # noqa: BLE001 - whoever asks next is told
            self._cause = error
        finally:
            self._session = None

    def _transport(self) -> contextlib.AbstractAsyncContextManager[Any]:
        if self.server.transport == STDIO:
            return stdio_transport(self.server, self.remarks, self.limits.max_bytes)
        return http_transport(self.server, self.limits.connect_s, self.limits.max_bytes)

    async def _shake_hands(self, session: ClientSession) -> None:
        # Every server of today answers `initialize`, those of before 2026 nothing else; a newer one names its versions.
        try:
            await session.initialize()
        except MCPError as error:
            if error.code not in (UNSUPPORTED_PROTOCOL_VERSION, METHOD_NOT_FOUND):
                raise
            await session.discover()
            self._modern = True
        capabilities, info = session.server_capabilities, session.server_info
        self.capabilities = {} if capabilities is None else capabilities.model_dump(exclude_none=True)
        self.info = {} if info is None else {"name": info.name, "version": info.version}

    async def _send(self, method: str, params: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        session, dispatcher = self._session, self._dispatcher
        if session is None or dispatcher is None:
            raise ServerFault("died", self.death(), sent=False)
        if self._modern:
            asked = Request[dict[str, Any], str](method=method, params=params)
            answer: Any = _OBJECT  # the annotation knows of models alone
            result: dict[str, Any] = await session.send_request(asked, answer, request_read_timeout_seconds=timeout_s)
            return result
        # Not through the session: one tool that is malformed would cost the whole list, and the session holds results
        # to output schemas in ways that a hostile one can draw out for ever.
        return await dispatcher.send_raw_request(method, params, {"timeout": timeout_s})

    async def _list_roots(self, context: ClientRequestContext) -> ListRootsResult:
        roots = [{"uri": Path(root).absolute().as_uri()} for root in self._roots]
        return ListRootsResult.model_validate({"roots": roots})

    async def _notice(self, message: object) -> None:
        if isinstance(message, ToolListChangedNotification) and self._on_tools_changed is not None:
            self._on_tools_changed()


@contextlib.asynccontextmanager
async def connected(server: Server, limits: Limits, roots: Sequence[str] = ()) -> AsyncIterator[Connection]:
    """Open a connection for the time of a block."""
    connection = Connection(server, limits, roots)
    try:
        await connection.open()
        yield connection
    finally:
        await connection.close()


class _Watched:
    """A stream of messages that tells when it has ended, before anyone who waits for a message is told."""

    def __init__(self, inner: Any, ended: asyncio.Event) -> None:
        self._inner, self._watched_end = inner, ended

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def __aiter__(self) -> _Watched:
        return self

    async def __anext__(self) -> Any:
        try:
            return await self._inner.__anext__()
        except BaseException:
            self._watched_end.set()
            raise

    async def __aenter__(self) -> _Watched:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._inner.aclose()


async def _first(*events: asyncio.Event) -> None:
    waiting = [asyncio.ensure_future(event.wait()) for event in events]
    try:
        await asyncio.wait(waiting, return_when="FIRST_COMPLETED")
    finally:
        for task in waiting:
            task.cancel()


def _fault(error: MCPError, said: str, timeout_s: float) -> ServerFault:
    message = shortened(said, 2000) or "no reason given"
    if error.code == REQUEST_TIMEOUT:
        return ServerFault("timeout", f"it did not answer within {timeout_s:g} s", code=error.code)
    if error.code in (NOT_SENT, SESSION_LOST):
        return ServerFault("unreachable", message, sent=False, code=error.code)
    if error.code in (LOST, CONNECTION_CLOSED):
        return ServerFault("died", message, code=error.code)
    kind = {TOO_LONG: "too_long", UNREADABLE: "protocol"}.get(error.code, "error")
    return ServerFault(kind, message, code=error.code)


def _innermost(error: BaseException | None) -> BaseException | None:
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error


def _words(error: BaseException | None) -> str:
    if error is None:
        return "the connection was closed"
    return f"{type(error).__name__}: {shortened(str(error), 300)}".rstrip(": ")


def _version() -> str:
    import gem_core

    return gem_core.__version__
