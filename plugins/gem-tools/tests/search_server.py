"""An HTTP server with scripted answers that runs on the library's loop."""

from __future__ import annotations

import asyncio  # noqa: TC003 - a dataclass
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from aiohttp import web

from gem_core.background import run_sync


@dataclass
class Reply:
    """What goes back: JSON, or bytes as they are; nothing if the status is 0."""

    body: Any = None
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)


@dataclass
class Server:
    """Answers with the replies in turn, the last one again and again; notes path, headers and body of each request."""

    replies: list[Reply]
    requests: list[tuple[str, dict[str, str], Any]] = field(default_factory=list)
    held: asyncio.Event | None = None
    url: str = ""

    async def answer(self, request: web.Request) -> web.Response:
        self.requests.append((request.path, dict(request.headers), await request.json()))
        reply = self.replies.pop(0) if len(self.replies) > 1 else self.replies[0]
        if self.held is not None:
            await self.held.wait()
        if reply.status == 0:
            if request.transport is not None:
                request.transport.close()
            return web.Response()
        content = reply.body if isinstance(reply.body, bytes) else json.dumps(reply.body).encode()
        return web.Response(body=content, status=reply.status, headers=reply.headers)


@contextmanager
def serving(*replies: Reply) -> Iterator[Server]:
    """Run a server for as long as the block lasts."""
    server = Server(list(replies))
    app = web.Application()
    app.router.add_post("/{path:.*}", server.answer)
    with running(app) as server.url:
        yield server


@contextmanager
def running(app: web.Application) -> Iterator[str]:
    """Run an application on a free port; give its address."""

    async def start() -> tuple[web.AppRunner, str]:
        runner = web.AppRunner(app, shutdown_timeout=0.1, access_log=None)
        await runner.setup()
        site = web.TCPSite(runner, "127.0.0.1", 0)
        await site.start()
        return runner, f"http://127.0.0.1:{runner.addresses[0][1]}"

    runner, url = run_sync(start())
    try:
        yield url
    finally:
        run_sync(runner.cleanup())
