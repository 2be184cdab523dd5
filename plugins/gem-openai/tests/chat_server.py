"""A server that speaks the OpenAI chat API and its faults, and what tests ask an agent with.

The server runs on the library's loop, as the agent does, so that tests can wait for events instead of sleeping.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

from gem_core import Response
from gem_core.background import run_sync
from gem_core.rollouts import Context
from gem_openai import OpenAIAgent

MODEL = "toy-model"
KEY = "key-0123456789-abcdefghij"
USAGE = {"prompt_tokens": 7, "completion_tokens": 3, "total_tokens": 10}


@dataclass
class Request:
    """What a client sent."""

    method: str
    path: str
    headers: dict[str, str]
    body: Any


@dataclass
class Reply:
    """What goes back.

    Args:
        body: JSON, or bytes that are sent as they are.
        status: HTTP status.
        headers: More headers.
        cut: Whether the connection is closed when half of the body is sent.
    """

    body: Any = None
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)
    cut: bool = False


def completion(text: str | None = "ok", *, finish_reason: str = "stop", **message: Any) -> dict[str, Any]:
    """Return a completion with one choice."""
    content = {"role": "assistant", "content": text, **message}
    choice = {"index": 0, "message": content, "finish_reason": finish_reason}
    return {"id": "c", "object": "chat.completion", "model": MODEL, "choices": [choice], "usage": USAGE}


def error(status: int, message: str, code: str | None = None, **headers: str) -> Reply:
    """Return a refusal as OpenAI words it."""
    return Reply({"error": {"message": message, "type": "x", "param": None, "code": code}}, status, headers)


def stream(*chunks: Any, done: bool = True) -> Reply:
    """Return server-sent events."""
    lines = [f"data: {json.dumps(chunk)}\n\n" for chunk in chunks] + (["data: [DONE]\n\n"] if done else [])
    return Reply("".join(lines).encode(), headers={"Content-Type": "text/event-stream"})


def delta(finish_reason: str | None = None, **delta: Any) -> dict[str, Any]:
    """Return one chunk of a stream."""
    return {"model": MODEL, "choices": [{"index": 0, "delta": delta, "finish_reason": finish_reason}]}


MakeAgent = Callable[..., OpenAIAgent]
Answer = Reply | Callable[[Request], Awaitable[Reply]]


class ChatServer:
    """Answers chats from a script, and when that is at its end, with ``otherwise``."""

    def __init__(self) -> None:
        self.script: list[Answer] = []
        self.otherwise: Answer = Reply(completion())
        self.models: Reply = Reply({"data": [{"id": MODEL}]})
        self.requests: list[Request] = []
        self.in_flight = self.peak = 0
        self._server = run_sync(asyncio.start_server(self._serve, "127.0.0.1", 0, backlog=512))
        self._connections: set[asyncio.Task[None]] = set()
        self.url = f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}/v1"

    @property
    def chats(self) -> list[dict[str, Any]]:
        """The bodies of all chats that were asked for."""
        return [request.body for request in self.requests if request.method == "POST"]

    def close(self) -> None:
        """Stop listening, and end what is under way."""
        run_sync(self._close())

    async def _close(self) -> None:
        self._server.close()
        for task in self._connections:
            task.cancel()
        await asyncio.gather(*self._connections, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._connections.add(task)
        try:
            while await self._answer_one(reader, writer):
                pass
        except (OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
            pass  # the client went away, or the test is over
        finally:
            self._connections.discard(task)
            writer.close()

    async def _answer_one(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
        method, path, _ = head[0].split(" ")
        headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in head[1:] if line)}
        body = await reader.readexactly(int(headers.get("content-length", 0)))
        request = Request(method, path, headers, json.loads(body) if body else None)
        self.requests.append(request)
        self.in_flight += 1
        self.peak = max(self.peak, self.in_flight)
        try:
            reply = await self._reply(request)
        finally:
            self.in_flight -= 1
        content = reply.body if isinstance(reply.body, bytes) else json.dumps(reply.body).encode()
        fields = {"Content-Type": "application/json", "Content-Length": str(len(content)), **reply.headers}
        lines = [f"HTTP/1.1 {reply.status} X", *(f"{name}: {value}" for name, value in fields.items())]
        writer.write(
            "\r\n".join(lines).encode() + b"\r\n\r\n" + (content[: len(content) // 2] if reply.cut else content)
        )
        await writer.drain()
        return not reply.cut

    async def _reply(self, request: Request) -> Reply:
        if request.path == "/v1/models":
            return self.models
        answer = self.script.pop(0) if self.script else self.otherwise
        return answer if isinstance(answer, Reply) else await answer(request)


class Waits(list[float]):
    """Stands in for ``asyncio.sleep``: notes how long each wait would be, and does not wait."""

    async def __call__(self, seconds: float) -> None:
        self.append(seconds)
        await asyncio.sleep(0)  # the loop learns of connections that were closed


def context(
    turn: int = 0, *, deadline: float | None = None, tools: Any = (), system: str | None = None, **info: Any
) -> Context:
    """Return what an agent is given in a turn."""
    return Context("0.0", "toy:Echo-v0", None, turn, info, list(tools), [], deadline, system)


def ask(agent: OpenAIAgent, observation: Any = "hello", **options: Any) -> Response:
    """Return an agent's answer, from plain code."""
    return run_sync(agent(observation, context(**options)))


def waits(agent: OpenAIAgent) -> list[float]:
    """Return how long an agent waited between its attempts."""
    assert isinstance(agent.client.sleep, Waits)
    return agent.client.sleep
