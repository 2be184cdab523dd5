"""The endpoint: what clients get that do something wrong, in each API's own form; and clients that are not ours."""

from __future__ import annotations

import asyncio
import http.client
import json
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest

from gem_core import Response
from gem_core.background import run_sync
from gem_server import endpoint as module
from gem_server.endpoint import Endpoint, Pending, Session

PATHS = {"chat": "/v1/chat/completions", "responses": "/v1/responses", "messages": "/v1/messages"}
HELLO = {
    "chat": {"model": "m", "messages": [{"role": "user", "content": "hello"}]},
    "responses": {"model": "m", "input": "hello"},
    "messages": {"model": "m", "max_tokens": 5, "messages": [{"role": "user", "content": "hello"}]},
}
server = Endpoint()


@pytest.fixture
def session() -> Iterator[Session]:
    opened = run_sync(server.open())
    yield opened

    async def close() -> None:
        server.close(opened, "the episode is over")

    run_sync(close())


def post(session: Session | None, path: str, body: Any) -> tuple[int, Any]:
    host = server.address.removeprefix("http://")
    connection = http.client.HTTPConnection(host, timeout=60)
    data = body if isinstance(body, bytes) else json.dumps(body)
    connection.request("POST", path, data, {"x-api-key": "wrong" if session is None else session.key})
    reply = connection.getresponse()
    told = json.loads(reply.read())
    connection.close()
    return reply.status, told


def replying(session: Session, replies: list[Response]) -> Callable[[], Awaitable[list[Any]]]:
    """Answer requests of a session one after another; return what was asked."""

    async def answer() -> list[Any]:
        asked = []
        for reply in replies:
            pending = await session.requests.get()
            assert isinstance(pending, Pending)
            asked.append(pending.asked)
            pending.reply.set_result(reply)
        return asked

    return answer


@pytest.mark.parametrize("api", PATHS)
def test_errors_have_the_form_of_the_api(api: str, session: Session) -> None:
    """A wrong key, a body that is none, a request that cannot be read, and one after the end."""
    path = PATHS[api]
    cases: list[tuple[Session | None, Any, int, str]] = [
        (None, HELLO[api], 401, "key"),
        (session, b"{", 400, "no JSON"),
        (session, [], 400, "an object"),
        (session, {"messages": [], "input": []}, 400, "at least one"),
        (session, {"messages": [3], "input": [3]}, 400, "[0] must be an object"),
        (
            session,
            {**HELLO[api], "messages": [{"role": "user", "content": [{"type": "audio"}]}], "input": [{"type": "x"}]},
            400,
            "type",
        ),
    ]
    for who, body, status, told in cases:
        found, error = post(who, path, body)
        assert found == status
        assert told in error["error"]["message"]
        assert (error.get("type") == "error") is (api == "messages")

    async def end() -> None:
        server.close(session, "the episode is over")

    run_sync(end())
    status, error = post(session, path, HELLO[api])
    assert (status, error["error"]["message"]) == (410, "the episode is over")


def test_a_body_that_is_too_large_is_refused(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before it is read whole."""
    monkeypatch.setattr(module, "MOST_BYTES", 1000)
    status, error = post(session, PATHS["chat"], {"messages": [{"role": "user", "content": "a" * 2000}]})
    assert (status, "larger" in error["error"]["message"]) == (413, True)


def test_a_client_that_vanishes_ends_its_episode_alone(session: Session) -> None:
    """While it waits for its reply; whoever plays the episode learns of it."""
    connection = http.client.HTTPConnection(server.address.removeprefix("http://"), timeout=60)
    connection.request("POST", PATHS["chat"], json.dumps(HELLO["chat"]), {"x-api-key": session.key})

    async def first() -> Any:
        return await session.requests.get()

    pending = run_sync(first())
    assert pending.asked.messages == HELLO["chat"]["messages"]
    connection.close()
    assert "closed its connection" in run_sync(first())
    assert pending.reply.cancelled()


def test_the_clients_of_openai_read_all_that_is_sent(session: Session) -> None:
    """Text, calls and usage, by both of their APIs, streamed and not."""
    openai = pytest.importorskip("openai", reason="the client of OpenAI's APIs")
    call = {"id": "c1", "type": "function", "function": {"name": "look", "arguments": '{"at": "sky"}'}}
    usage = {"prompt_tokens": 7, "completion_tokens": 2}
    replies = [Response("a sky", tool_calls=[call], usage=usage, model="scripted", reasoning="hm")] * 4

    async def talk() -> list[Any]:
        answering = asyncio.create_task(replying(session, replies)())
        async with openai.AsyncOpenAI(base_url=f"{server.address}/v1", api_key=session.key, max_retries=0) as client:
            tools: Any = [{"type": "function", "function": {"name": "look", "parameters": {"type": "object"}}}]
            hello: Any = HELLO["chat"]["messages"]
            chat = await client.chat.completions.create(model="m", messages=hello, tools=tools, stop=["x"])
            message = chat.choices[0].message
            assert (message.content, message.tool_calls[0].function.arguments) == ("a sky", '{"at": "sky"}')
            assert (chat.choices[0].finish_reason, chat.usage.prompt_tokens, chat.model) == (
                "tool_calls",
                7,
                "scripted",
            )
            options: Any = {"include_usage": True}
            async with client.chat.completions.stream(model="m", messages=hello, stream_options=options) as stream:
                final = await stream.get_final_completion()
            assert (final.choices[0].message.content, final.usage.completion_tokens) == ("a sky", 2)
            assert final.choices[0].message.tool_calls[0].function.name == "look"
            made = await client.responses.create(model="m", input="hello", instructions="be brief")
            assert (made.output_text, made.output[-1].call_id, made.usage.total_tokens) == ("a sky", "c1", 9)
            async with client.responses.stream(model="m", input="hello") as stream:
                response = await stream.get_final_response()
            assert (response.output_text, response.output[-1].arguments) == ("a sky", '{"at": "sky"}')
            assert [each.id async for each in await client.models.list()] == ["gem"]
        return await answering

    asked = run_sync(talk())
    assert asked[0].sampling == {"stop": ["x"]}
    assert asked[2].messages[0] == {"role": "system", "content": "be brief"}


def test_the_client_of_anthropic_reads_all_that_is_sent(session: Session) -> None:
    """Text, thinking, calls and usage, streamed and not; results of tools become messages of their own."""
    anthropic = pytest.importorskip("anthropic", reason="the client of Anthropic's API")
    call = {"id": "c1", "type": "function", "function": {"name": "look", "arguments": '{"at": "sky"}'}}
    replies = [Response("a sky", tool_calls=[call], reasoning="hm"), Response("blue", finish_reason="length")]

    async def talk() -> list[Any]:
        answering = asyncio.create_task(replying(session, replies)())
        async with anthropic.AsyncAnthropic(base_url=server.address, api_key=session.key, max_retries=0) as client:
            tools: Any = [{"name": "look", "description": "looks", "input_schema": {"type": "object"}}]
            messages: Any = [{"role": "user", "content": "hello"}]
            first = await client.messages.create(
                model="m", max_tokens=5, system="brief", messages=messages, tools=tools
            )
            assert [block.type for block in first.content] == ["thinking", "text", "tool_use"]
            assert (first.content[2].input, first.stop_reason) == ({"at": "sky"}, "tool_use")
            result = {"type": "tool_result", "tool_use_id": "c1", "content": [{"type": "text", "text": "clouds"}]}
            messages += [{"role": "assistant", "content": first.content}, {"role": "user", "content": [result]}]
            async with client.messages.stream(model="m", max_tokens=5, messages=messages, tools=tools) as stream:
                final = await stream.get_final_message()
            assert (final.content[0].text, final.stop_reason) == ("blue", "max_tokens")
            counted = await client.messages.count_tokens(model="m", messages=messages)
            assert counted.input_tokens > 0
        return await answering

    asked = run_sync(talk())
    assert asked[0].tools[0]["function"]["name"] == "look"
    roles = [(message["role"], message.get("tool_call_id")) for message in asked[1].messages]
    assert roles == [("user", None), ("assistant", None), ("tool", "c1")]
    assert asked[1].messages[1]["tool_calls"][0]["function"]["arguments"] == '{"at": "sky"}'
