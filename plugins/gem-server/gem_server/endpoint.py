"""The agent endpoint: a server on loopback at which a program asks "the model", with a secret for each episode."""

from __future__ import annotations

import asyncio
import itertools
import json
import logging
import secrets
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, StreamingResponse
from starlette.responses import Response as HttpResponse
from starlette.routing import Route

from gem_core import Response
from gem_server import chat, messages, responses
from gem_server.asked import Api, Asked, BadRequestError

logger = logging.getLogger("gem_server")

MOST_BYTES = 64 << 20
"""Largest body of a request: a long conversation with images."""

Act = Callable[[str], Awaitable[dict[str, Any]]]
"""Hands an action to the task; returns what the program is told."""


@dataclass
class Pending:
    """A request that waits for its reply.

    Args:
        asked: The request.
        reply: Resolved by the reply.
    """

    asked: Asked
    reply: asyncio.Future[Response] = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class SessionEndedError(Exception):
    """The episode is over; the text says why."""


class Session:
    """One episode's address: its secret, the requests that wait, and the way to the task.

    Args:
        act: Hands an action to the task; None where the program does not act by this server.
    """

    def __init__(self, act: Act | None = None) -> None:
        self.key = f"gem-{secrets.token_hex(24)}"
        self.act = act
        self.requests: asyncio.Queue[Pending | str] = asyncio.Queue()
        """Requests in order of arrival; and why there will be none, as part of a sentence about the program."""
        self._waiting: set[asyncio.Future[Response]] = set()
        self._ended: str | None = None

    async def ask(self, asked: Asked) -> Response:
        """Wait for the reply to a request.

        Raises:
            SessionEndedError: The episode is over.
        """
        if self._ended is not None:
            raise SessionEndedError(self._ended)
        pending = Pending(asked)
        self._waiting.add(pending.reply)
        self.requests.put_nowait(pending)
        try:
            return await pending.reply
        finally:
            self._waiting.discard(pending.reply)

    def end(self, why: str) -> None:
        """End the session: whoever waits, and every later request, is told why."""
        self._ended = why
        for reply in self._waiting:
            if not reply.done():
                reply.set_exception(SessionEndedError(why))
                reply.exception()  # so that asyncio does not log it if the client has gone


class Endpoint:
    """A server on loopback that speaks three APIs of model servers; each episode has a secret of its own.

    ``POST /v1/chat/completions`` and ``/v1/responses`` as OpenAI's, ``POST /v1/messages`` as Anthropic's, streamed and
    not; ``GET /v1/models``; and ``POST /act`` with ``{"action": text}`` hands an action to the task. The secret is the
    key of the API. It runs on the library's own event loop, and ends with the process.

    Args:
        model: The name under which ``/v1/models`` lists the model.
    """

    def __init__(self, model: str = "gem") -> None:
        self.model = model
        self._sessions: dict[str, Session] = {}
        self._numbers = itertools.count()
        self._serving: asyncio.Task[None] | None = None
        self._address = ""

    @property
    def address(self) -> str:
        """As ``http://127.0.0.1:8123``; empty before the first session."""
        return self._address

    async def open(self, act: Act | None = None) -> Session:
        """Return a new session; the server starts with the first one. Call it on the library's own event loop."""
        if self._serving is None:
            listening = socket.socket()
            listening.bind(("127.0.0.1", 0))
            self._address = f"http://127.0.0.1:{listening.getsockname()[1]}"
            config = uvicorn.Config(
                self._app(), log_config=None, access_log=False, lifespan="off", timeout_keep_alive=600
            )
            self._serving = asyncio.create_task(uvicorn.Server(config).serve(sockets=[listening]))
        session = Session(act)
        self._sessions[session.key] = session
        return session

    def close(self, session: Session, why: str) -> None:
        """End a session; its secret stays known, so that later requests are told why."""
        session.end(why)
        self._sessions[session.key] = session
        if len(self._sessions) > 10_000:
            for key in list(self._sessions)[:1000]:
                del self._sessions[key]

    # The server.

    def _app(self) -> Starlette:
        routes = [
            Route("/v1/chat/completions", self._of(chat), methods=["POST"]),
            Route("/v1/responses", self._of(responses), methods=["POST"]),
            Route("/v1/messages", self._of(messages), methods=["POST"]),
            Route("/v1/messages/count_tokens", self._count_tokens, methods=["POST"]),
            Route("/v1/models", self._models),
            Route("/act", self._act, methods=["POST"]),
        ]
        return Starlette(routes=routes, exception_handlers={HTTPException: _http_error})

    def _of(self, api: Api) -> Callable[[Request], Awaitable[HttpResponse]]:
        async def answer(request: Request) -> HttpResponse:
            try:
                return await self._answer(api, request)
            except HTTPException as error:
                return JSONResponse(api.error(error.status_code, error.detail), error.status_code)

        return answer

    def _session(self, request: Request) -> Session:
        given = (
            request.headers.get("x-api-key") or request.headers.get("authorization", "").removeprefix("Bearer ").strip()
        )
        session = self._sessions.get(given)
        if session is None:
            raise HTTPException(
                401, "this key is of no episode; a program gets its own in OPENAI_API_KEY or ANTHROPIC_API_KEY"
            )
        return session

    async def _answer(self, api: Api, request: Request) -> HttpResponse:
        session = self._session(request)
        body = await _json_of(request)
        try:
            asked = api.read(body)
        except BadRequestError as error:
            raise HTTPException(400, str(error)) from None
        response = await self._reply_to(session, asked, request)
        number = f"{next(self._numbers):x}{secrets.token_hex(6)}"
        if not asked.stream:
            return JSONResponse(api.reply(asked, response, number))

        async def lines() -> AsyncIterator[str]:
            for name, data in api.events(asked, response, number):
                text = data if isinstance(data, str) else json.dumps(data)
                yield (f"event: {name}\n" if name else "") + f"data: {text}\n\n"

        return StreamingResponse(lines(), media_type="text/event-stream", headers={"cache-control": "no-cache"})

    async def _reply_to(self, session: Session, asked: Asked, request: Request) -> Response:
        """Return the reply; a client that vanishes while it waits ends its episode."""
        reply = asyncio.ensure_future(session.ask(asked))
        gone = asyncio.ensure_future(_gone(request))
        try:
            await asyncio.wait({reply, gone}, return_when=asyncio.FIRST_COMPLETED)
            if not reply.done():
                session.requests.put_nowait("closed its connection while it waited for a reply")
                raise HTTPException(499, "the client has gone")
            return reply.result()
        except SessionEndedError as ended:
            raise HTTPException(410, str(ended)) from None
        finally:
            reply.cancel()
            gone.cancel()

    async def _act(self, request: Request) -> HttpResponse:
        session = self._session(request)
        action = (await _json_of(request)).get("action")
        if not isinstance(action, str):
            raise HTTPException(400, 'the body must be {"action": text}')
        if session.act is None:
            raise HTTPException(404, "this program does not act by the server")
        try:
            return JSONResponse(await session.act(action))
        except SessionEndedError as ended:
            raise HTTPException(410, str(ended)) from None

    async def _models(self, request: Request) -> HttpResponse:
        self._session(request)
        model = {"id": self.model, "object": "model", "created": 0, "owned_by": "gem"}
        return JSONResponse(
            {"object": "list", "data": [model], "has_more": False, "first_id": self.model, "last_id": self.model}
        )

    async def _count_tokens(self, request: Request) -> HttpResponse:
        """Estimate: four characters a token, since this server has no tokenizer."""
        self._session(request)
        return JSONResponse({"input_tokens": len(json.dumps((await _json_of(request)).get("messages", []))) // 4})


async def _json_of(request: Request) -> dict[str, Any]:
    """Return the body of a request as an object."""
    body = bytearray()
    try:
        async for chunk in request.stream():
            body += chunk
            if len(body) > MOST_BYTES:
                raise HTTPException(413, f"the body is larger than {MOST_BYTES >> 20} MiB")
    except ClientDisconnect:
        raise HTTPException(499, "the client has gone") from None
    try:
        read_as = json.loads(body)
    except (ValueError, RecursionError):
        raise HTTPException(400, "the body is no JSON") from None
    if not isinstance(read_as, dict):
        raise HTTPException(400, f"the body must be an object, not {type(read_as).__name__}")
    return read_as


async def _gone(request: Request) -> None:
    """Return when the client has closed its connection."""
    with suppress(ClientDisconnect):
        while not await request.is_disconnected():
            await asyncio.sleep(0.25)


async def _http_error(request: Request, error: Exception) -> HttpResponse:
    status = getattr(error, "status_code", 500)
    return JSONResponse(chat.error(status, getattr(error, "detail", "the server failed")), status)
