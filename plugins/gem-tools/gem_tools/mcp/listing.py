"""What servers offer: asked once for each server and process, from whichever thread."""

from __future__ import annotations

import asyncio
import concurrent.futures
import os
import threading
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from gem_core.errors import GemError
from gem_tools.mcp.connection import Connection, Limits, ServerFault, connected
from gem_tools.mcp.messages import shortened

if TYPE_CHECKING:
    from gem_tools.mcp.config import Server

T = TypeVar("T")

MAX_PAGES = 100
MAX_ITEMS = 1000

_lock = threading.Lock()
_listings: dict[Server, Listing] = {}
_asking: dict[Server, threading.Lock] = {}


@dataclass(frozen=True)
class Offer:
    """A tool of a server.

    Args:
        name: What the server calls it.
        description: In its words.
        schema: Of the arguments: a JSON Schema of an object, not to be trusted.
        repeatable: Whether the server says that a second call does no harm.
    """

    name: str
    description: str
    schema: Mapping[str, Any]
    repeatable: bool = False


@dataclass(frozen=True)
class Listing:
    """What a server offers.

    Args:
        tools: Its tools, in its order.
        resources: Whether it has resources.
        prompts: Whether it has prompts.
        info: Its own name and version.
        problems: What is wrong with the list, in words.
    """

    tools: tuple[Offer, ...]
    resources: bool = False
    prompts: bool = False
    info: Mapping[str, Any] = field(default_factory=dict)
    problems: tuple[str, ...] = ()


def listings(servers: Sequence[Server], limits: Limits, roots: Sequence[str] = ()) -> list[Listing]:
    """Return what servers offer, in order; each is asked once, and for as long as its tools stay the same.

    Waits, also on the library's event loop: the servers are asked on a loop of its own in another thread.

    Raises:
        GemError: A server cannot be started or reached, or does not answer.
    """
    found = asked(servers, limits, roots)
    broken = [listing for listing in found if isinstance(listing, GemError)]
    if len(broken) > 1:
        raise GemError(f"{len(broken)} of {len(found)} MCP servers cannot be used: {'; '.join(map(str, broken))}")
    if broken:
        raise broken[0]
    return [listing for listing in found if isinstance(listing, Listing)]


def asked(servers: Sequence[Server], limits: Limits, roots: Sequence[str] = ()) -> list[Listing | GemError]:
    """Return what servers offer, with an error in the place of each that does not answer."""
    answers: dict[Server, Listing | GemError] = {}
    with _lock:
        locks = sorted((_asking.setdefault(server, threading.Lock()) for server in set(servers)), key=id)
    taken = []
    try:
        # In one order, so that two threads never wait for each other.
        for lock in locks:
            lock.acquire()
            taken.append(lock)
        with _lock:
            answers.update({server: _listings[server] for server in servers if server in _listings})
        missing = [server for server in dict.fromkeys(servers) if server not in answers]
        if missing:
            answers.update(zip(missing, on_own_loop(lambda: _ask_all(missing, limits, roots)), strict=True))
        with _lock:
            _listings.update({s: answer for s, answer in answers.items() if isinstance(answer, Listing)})
    finally:
        for lock in taken:
            lock.release()
    return [answers[server] for server in servers]


def forget(server: Server) -> None:
    """Ask a server again when its tools are wanted next: it has said that they are others now."""
    with _lock:
        _listings.pop(server, None)


async def listing_of(connection: Connection) -> Listing:
    """Ask a server what it offers.

    Raises:
        ServerFault: It does not answer.
    """
    problems: list[str] = []
    tools: dict[str, Offer] = {}
    if "tools" in connection.capabilities:
        for item in await paged(connection, "tools/list", "tools", problems):
            offer = _offer(item, problems)
            if offer is not None and offer.name in tools:
                problems.append(f"it has several tools of the name {shortened(offer.name)!r}; only the first is used")
            elif offer is not None:
                tools[offer.name] = offer
    # Many servers declare both and have neither.
    resources = await _any(connection, "resources", ("resources/list", "resources"))
    resources = resources or await _any(connection, "resources", ("resources/templates/list", "resourceTemplates"))
    prompts = await _any(connection, "prompts", ("prompts/list", "prompts"))
    return Listing(tuple(tools.values()), resources, prompts, connection.info, tuple(problems))


async def paged(connection: Connection, method: str, key: str, problems: list[str] | None = None) -> list[Any]:
    """Return a list that a server gives page by page; one that never ends is cut, and ``problems`` says so.

    Raises:
        ServerFault: The server does not answer within the time for lists.
    """
    problems = [] if problems is None else problems
    items: list[Any] = []
    cursor: object = None
    seen: set[str] = set()
    loop = asyncio.get_running_loop()
    deadline = loop.time() + connection.limits.list_s
    for _ in range(MAX_PAGES):
        left = deadline - loop.time()
        if left <= 0:
            raise ServerFault("timeout", f"{method} took more than {connection.limits.list_s:g} s")
        page = await connection.request(method, {} if cursor is None else {"cursor": cursor}, left)
        found = page.get(key)
        if not isinstance(found, list):
            raise ServerFault("protocol", f"the answer to {method} has no list of {key}")
        items += found[: MAX_ITEMS - len(items)]
        cursor = page.get("nextCursor")
        if not isinstance(cursor, str) or not cursor:
            return items
        if cursor in seen or len(items) >= MAX_ITEMS:
            break
        seen.add(cursor)
    problems.append(f"its list of {key} does not end; the first {len(items)} are used")
    return items


def on_own_loop(work: Callable[[], Coroutine[Any, Any, T]]) -> T:
    """Run a coroutine to its end on an event loop of its own, in a thread of its own, and wait for it."""
    result: concurrent.futures.Future[T] = concurrent.futures.Future()
    started: concurrent.futures.Future[tuple[asyncio.AbstractEventLoop, asyncio.Task[Any] | None]] = (
        concurrent.futures.Future()
    )

    async def main() -> T:
        started.set_result((asyncio.get_running_loop(), asyncio.current_task()))
        return await work()

    def run() -> None:
        try:
            result.set_result(asyncio.run(main()))
        except BaseException as error:  # noqa: BLE001 - it is raised again in the thread that waits
            result.set_exception(error)

    thread = threading.Thread(target=run, name="gem-mcp-list", daemon=True)
    thread.start()
    try:
        return result.result()
    except BaseException:
        if not result.done():  # Ctrl-C: servers that were started are ended
            loop, task = started.result()
            if task is not None:
                loop.call_soon_threadsafe(task.cancel)
            thread.join(timeout=10)
        raise


async def _ask_all(servers: Sequence[Server], limits: Limits, roots: Sequence[str]) -> list[Listing | GemError]:
    return await asyncio.gather(*(_ask(server, limits, roots) for server in servers))


async def _ask(server: Server, limits: Limits, roots: Sequence[str]) -> Listing | GemError:
    connection: Connection | None = None
    try:
        async with connected(server, limits, roots) as connection:
            return await listing_of(connection)
    except ServerFault as fault:
        name = repr(server.name)
        if connection is None:
            return fault  # which names it
        said = "" if fault.kind == "died" else connection.said()
        message = f"the MCP server {name} ({server.place}) does not tell what it offers: {fault.message}"
        message += f"; {said}" if said else ""
        return ServerFault(fault.kind, message, sent=fault.sent, code=fault.code)
    except GemError as error:
        return error


async def _any(connection: Connection, capability: str, listed: tuple[str, str]) -> bool:
    if capability not in connection.capabilities:
        return False
    try:
        return bool((await connection.request(listed[0], {}, connection.limits.list_s)).get(listed[1]))
    except ServerFault as fault:
        if fault.kind in ("error", "protocol"):
            return False
        raise


def _offer(item: object, problems: list[str]) -> Offer | None:
    name = item.get("name") if isinstance(item, Mapping) else None
    if not isinstance(item, Mapping) or not isinstance(name, str) or not name:
        problems.append(f"a tool without a name is left out: {shortened(repr(item))}")
        return None
    notes = item.get("annotations")
    notes = notes if isinstance(notes, Mapping) else {}
    schema = item.get("inputSchema")
    if not isinstance(schema, Mapping) or schema.get("type", "object") != "object":
        problems.append(f"the schema of {shortened(name)!r} is not that of an object; its arguments are not checked")
        schema = {"type": "object"}
    described = (item.get("description"), item.get("title"), notes.get("title"))
    description = next((text for text in described if isinstance(text, str) and text.strip()), "")
    repeatable = notes.get("readOnlyHint") is True or notes.get("idempotentHint") is True
    return Offer(name, description, schema, repeatable)


def _after_fork() -> None:
    global _lock
    _lock = threading.Lock()
    _asking.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
