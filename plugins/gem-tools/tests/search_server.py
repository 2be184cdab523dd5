"""An HTTP server with scripted answers that runs on the library's loop, and a clock that nobody waits for."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from aiohttp import web

from gem_core.background import run_sync


@dataclass
class Request:
    """What a client sent."""

    method: str
    path: str
    query: dict[str, str]
    headers: dict[str, str]
    body: Any


@dataclass
class Reply:
    """What goes back: JSON, or bytes as they are."""

    body: Any = None
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)


class Server:
    """Answers with the replies in turn; the last one again and again.

    Args:
        replies: What goes back.
    """

    def __init__(self, *replies: Reply) -> None:
        self.replies = list(replies)
        self.requests: list[Request] = []
        self.held: asyncio.Event | None = None
        self.arrived = asyncio.Event()
        self.url = ""

    async def answer(self, request: web.Request) -> web.Response:
        body = await request.read()
        sent = json.loads(body) if body else None
        self.requests.append(Request(request.method, request.path, dict(request.query), dict(request.headers), sent))
        reply = self.replies.pop(0) if len(self.replies) > 1 else self.replies[0]
        self.arrived.set()
        if self.held is not None:
            await self.held.wait()
        if reply.body is None and reply.status == 0:
            if request.transport is not None:
                request.transport.close()
            return web.Response()
        content = reply.body if isinstance(reply.body, bytes) else json.dumps(reply.body).encode()
        return web.Response(body=content, status=reply.status, headers=reply.headers)


@contextmanager
def serving(*replies: Reply) -> Iterator[Server]:
    """Run a server for as long as the block lasts."""
    server = Server(*replies)

    async def start() -> web.AppRunner:
        app = web.Application()
        app.router.add_route("*", "/{path:.*}", server.answer)
        runner = web.AppRunner(app, shutdown_timeout=0.1, access_log=None)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        server.url = f"http://127.0.0.1:{runner.addresses[0][1]}"
        return runner

    runner = run_sync(start())
    try:
        yield server
    finally:
        run_sync(runner.cleanup())


class QuickClock:
    """A clock on which every wait is over at once; it notes how long each was."""

    def __init__(self) -> None:
        self.time = 0.0
        self.waits: list[float] = []

    def now(self) -> float:
        return self.time

    async def sleep(self, seconds: float) -> None:
        self.waits.append(seconds)
        self.time += seconds
        await asyncio.sleep(0)
