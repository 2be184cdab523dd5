"""What tools servers offer: asked once for each server and process, from whichever thread."""

from __future__ import annotations

import asyncio
import tempfile
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gem_core.errors import GemError
from gem_tools.mcp.connection import Connection, ServerFault
from gem_tools.mcp.text import shortened

if TYPE_CHECKING:
    from gem_tools.mcp.config import Server

MAX_ITEMS = 1000

_asking = threading.Lock()
_listings: dict[Server, Listing] = {}


@dataclass(frozen=True)
class Offer:
    """A tool of a server: its name and description there, and the JSON Schema of its arguments, not to be trusted."""

    name: str
    description: str
    schema: Mapping[str, Any]


@dataclass(frozen=True)
class Listing:
    """A server's tools in its order and what is wrong with them, in words; or why it does not tell them."""

    tools: tuple[Offer, ...] = ()
    problems: tuple[str, ...] = ()
    error: GemError | None = None


def listings(servers: Sequence[Server]) -> list[Listing]:
    """Return what servers offer, in order; raise a GemError if one cannot be used."""
    found = asked(servers)
    errors = [listing.error for listing in found if listing.error is not None]
    if len(errors) > 1:
        raise GemError(f"{len(errors)} of {len(found)} MCP servers cannot be used: {'; '.join(map(str, errors))}")
    if errors:
        raise errors[0]
    return found


def asked(servers: Sequence[Server]) -> list[Listing]:
    """Return what servers offer, in order; waits, also on a running event loop."""
    with _asking:  # if several threads want to know, the first asks, and the others wait for it
        new = [server for server in dict.fromkeys(servers) if server not in _listings]
        with ThreadPoolExecutor(1) as thread:  # with a loop of its own: the caller may be on an event loop itself
            told = thread.submit(asyncio.run, _ask_all(new)).result() if new else []
        found = _listings | dict(zip(new, told, strict=True))
        _listings.update({server: found[server] for server in new if found[server].error is None})
        return [found[server] for server in servers]


async def _ask_all(servers: Sequence[Server]) -> list[Listing]:
    return await asyncio.gather(*map(_ask, servers))


async def _ask(server: Server) -> Listing:
    with tempfile.TemporaryDirectory(prefix="gem-mcp-", ignore_cleanup_errors=True) as folder:
        connection = Connection(server.in_folder(folder))
        try:
            await connection.open()
        except GemError as error:
            return Listing(error=error)
        try:
            async with asyncio.timeout(server.connect_s):
                return await _listing(connection)
        except (ServerFault, TimeoutError) as fault:
            why = str(fault) or f"it did not list its tools within {server.connect_s:g} s"
            said = "" if isinstance(fault, ServerFault) and fault.kind == "died" else connection.said()
            message = f"the MCP server {server.name!r} ({server.place}) does not tell what it offers: {why}"
            return Listing(error=ServerFault("unreachable", f"{message}; {said}" if said else message))
        finally:
            await connection.close()


async def _listing(connection: Connection) -> Listing:
    """Return all tools as the server lists them, page by page; a list that does not end is cut."""
    problems: list[str] = []
    tools: dict[str, Offer] = {}
    items: list[Any] = []
    cursor: Any = None
    while connection.has_tools:
        params = {} if cursor is None else {"cursor": cursor}
        page = await connection.request("tools/list", params, connection.server.connect_s)
        found, last, cursor = page.get("tools"), cursor, page.get("nextCursor")
        if not isinstance(found, list):
            raise ServerFault("protocol", "the answer to tools/list has no list of tools")
        items += found[: MAX_ITEMS - len(items)]
        if not isinstance(cursor, str) or not cursor:
            break
        if not found or cursor == last or len(items) == MAX_ITEMS:
            problems.append(f"its list of tools does not end; the first {len(items)} are used")
            break
    for item in items:
        offer = _offer(item, problems)
        if offer is not None and offer.name in tools:
            problems.append(f"it has several tools of the name {shortened(offer.name)!r}; only the first is used")
        elif offer is not None:
            tools[offer.name] = offer
    return Listing(tuple(tools.values()), tuple(problems))


def _offer(item: object, problems: list[str]) -> Offer | None:
    name = item.get("name") if isinstance(item, Mapping) else None
    if not isinstance(item, Mapping) or not isinstance(name, str) or not name:
        problems.append(f"a tool without a name is left out: {shortened(repr(item))}")
        return None
    schema = item.get("inputSchema")
    if not isinstance(schema, Mapping) or schema.get("type", "object") != "object":
        problems.append(f"the schema of {shortened(name)!r} is not that of an object; its arguments are not checked")
        schema = {"type": "object"}
    described = (item.get("description"), item.get("title"))
    return Offer(name, next((text for text in described if isinstance(text, str) and text.strip()), ""), schema)
