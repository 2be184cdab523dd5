"""The agent that asks a model server, against a server that speaks the protocol and its faults."""

from __future__ import annotations

import asyncio
import base64
import io
import time
from email.utils import formatdate
from typing import Any

import pytest
from chat_server import (
    KEY,
    MODEL,
    USAGE,
    ChatServer,
    MakeAgent,
    Reply,
    Request,
    ask,
    completion,
    context,
    delta,
    error,
    stream,
    waits,
)

from gem_core.background import run_sync
from gem_core.errors import ContextOverflowError, RequestError

# What is sent.


def test_a_text_becomes_a_message_of_the_user(server: ChatServer, make_agent: MakeAgent) -> None:
    """With the key, the model and nothing that was not asked for."""
    assert ask(make_agent()) == "ok"
    (request,) = server.requests
    assert request.headers["authorization"] == f"Bearer {KEY}"
    assert request.body == {"model": MODEL, "messages": [{"role": "user", "content": "hello"}]}


def test_the_system_prompt_is_the_option_or_that_of_the_episode(server: ChatServer, make_agent: MakeAgent) -> None:
    """That of the environment holds for the whole episode; messages that bring one keep theirs."""
    agent = make_agent()
    ask(agent, system="from the task")
    ask(agent, turn=1, system="from the task")
    ask(agent)
    ask(make_agent(system="mine"), system="from the task")
    ask(make_agent(system="mine"), [{"role": "system", "content": "own"}, {"role": "user", "content": "x"}])
    firsts = [chat["messages"][0] for chat in server.chats]
    assert [message["content"] for message in firsts] == ["from the task", "from the task", "hello", "mine", "own"]


def test_images_arrive_as_data_urls(server: ChatServer, make_agent: MakeAgent) -> None:
    """As PNG, whatever their mode, alone and inside messages."""
    image_module = pytest.importorskip("PIL.Image")
    parts = [{"type": "text", "text": "see"}, {"type": "image", "image": image_module.new("CMYK", (3, 2))}]
    ask(make_agent(), parts)
    ask(make_agent(), [{"role": "user", "content": parts}])
    for chat in server.chats:
        text, image = chat["messages"][0]["content"]
        assert text == {"type": "text", "text": "see"}
        kind, _, data = image["image_url"]["url"].partition(",")
        assert (image["type"], kind) == ("image_url", "data:image/png;base64")
        assert image_module.open(io.BytesIO(base64.b64decode(data))).size == (3, 2)


# What comes back.


def test_everything_that_the_server_reports_is_kept(server: ChatServer, make_agent: MakeAgent) -> None:
    """Token ids and log-probabilities as vLLM gives them."""
    reply = completion("yes", finish_reason="length", reasoning_content="hm")
    reply["prompt_token_ids"] = [1, 2]
    reply["choices"][0] |= {"token_ids": [3, 4], "logprobs": {"content": [{"logprob": -0.5}, {"logprob": -1}]}}
    server.script = [Reply(reply)]
    response = ask(make_agent(return_token_ids=True))
    assert (server.chats[0]["return_token_ids"], server.chats[0]["logprobs"]) == (True, True)
    assert response == "yes"
    assert response.cut_off
    assert response.reported() == {
        "token_ids": [3, 4],
        "prompt_token_ids": [1, 2],
        "logprobs": [-0.5, -1.0],
        "finish_reason": "length",
        "reasoning": "hm",
        "usage": USAGE,
        "model": MODEL,
    }


def test_invalid_arguments_of_a_call_are_kept(server: ChatServer, make_agent: MakeAgent) -> None:
    """The tools answer them; what is no call at all is left out."""
    calls = [{"id": "c1", "function": {"name": "f", "arguments": '{"x": '}}, {"function": {"arguments": {"y": 1}}}, 7]
    server.script = [Reply(completion(None, finish_reason="tool_calls", tool_calls=calls))]
    response = ask(make_agent())
    assert response == ""
    assert response.tool_calls == [
        {"id": "c1", "type": "function", "function": {"name": "f", "arguments": '{"x": '}},
        {"id": "call_1", "type": "function", "function": {"name": "", "arguments": '{"y": 1}'}},
    ]


@pytest.mark.parametrize(
    ("message", "text"),
    [
        ({"content": None}, ""),
        ({"content": ""}, ""),
        ({}, ""),
        ({"content": 5, "tool_calls": "x", "reasoning": 1}, ""),
        ({"content": [{"type": "text", "text": "a"}, {"text": "b"}, 3]}, "ab"),
        ({"content": None, "refusal": "No."}, "No."),
    ],
)
def test_odd_messages_are_read(server: ChatServer, make_agent: MakeAgent, message: dict[str, Any], text: str) -> None:
    """What is missing or has a wrong type is not reported."""
    server.script = [Reply({"choices": [{"message": message, "token_ids": ["x"], "logprobs": {"content": [1]}}]})]
    response = ask(make_agent())
    assert response == text
    assert response.reported() == {}


def test_a_stream_is_joined(server: ChatServer, make_agent: MakeAgent) -> None:
    """Calls by their index, token ids in their order, usage from the last chunk."""
    first = delta(role="assistant", content="a", reasoning="r1") | {"prompt_token_ids": [1]}
    first["choices"][0] |= {"token_ids": [2], "logprobs": {"content": [{"logprob": -1.0}]}}
    second = delta(content="b", reasoning="r2")
    second["choices"][0] |= {"token_ids": [3], "logprobs": {"content": [{"logprob": -2.0}]}}
    server.script = [
        stream(
            first,
            second,
            delta(tool_calls=[{"index": 1, "id": "c2", "function": {"name": "g", "arguments": "{}"}}]),
            delta(tool_calls=[{"index": 0, "id": "c1", "function": {"name": "f", "arguments": '{"x"'}}]),
            delta("tool_calls", tool_calls=[{"index": 0, "function": {"arguments": ": 1}"}}]),
            {"choices": [], "usage": USAGE},
        )
    ]
    response = ask(make_agent(stream=True))
    assert (server.chats[0]["stream"], server.chats[0]["stream_options"]) == (True, {"include_usage": True})
    assert response == "ab"
    assert (response.reasoning, response.usage, response.finish_reason) == ("r1r2", USAGE, "tool_calls")
    assert (response.token_ids, response.prompt_token_ids, response.logprobs) == ([2, 3], [1], [-1.0, -2.0])
    calls = [
        (call["id"], call["function"]["name"], call["function"]["arguments"]) for call in response.tool_calls or ()
    ]
    assert calls == [("c1", "f", '{"x": 1}'), ("c2", "g", "{}")]


# Faults.


@pytest.mark.parametrize(
    "fault",
    [
        error(500, "oops"),
        error(429, "slow down"),
        error(408, "late"),
        error(409, "locked"),
        Reply(b"<html>bad gateway</html>", 502),
        Reply(b'{"choices": [{"mess'),
        Reply(b"[" * 100_000),
        Reply([1]),
        Reply({"choices": []}),
        Reply({"choices": None}),
        Reply({"error": {"message": "overloaded", "code": 503}}),
        Reply(completion(), cut=True),
        Reply(b"", cut=True),
        stream(delta(content="a"), done=False),
        stream(delta(content="a"), {"error": {"message": "lost"}}),
        Reply(b"data: {broken\n\n", headers={"Content-Type": "text/event-stream"}),
    ],
    ids=lambda fault: f"{fault.status} {str(fault.body)[:30]}",
)
def test_passing_faults_are_tried_again(server: ChatServer, make_agent: MakeAgent, fault: Reply) -> None:
    """With waits that double."""
    server.script = [fault, fault]
    agent = make_agent(stream=True)
    assert ask(agent) == "ok"
    assert waits(agent) == [0.5, 1.0]
    assert len(server.chats) == 3


@pytest.mark.parametrize("status", [400, 401, 403, 404, 413, 422, 302])
def test_refusals_are_not_tried_again(server: ChatServer, make_agent: MakeAgent, status: int) -> None:
    """The episode ends with what the server said."""
    agent = make_agent()
    assert ask(agent) == "ok"
    server.script = [error(status, "no\nway", Location="http://127.0.0.1:1/")]
    with pytest.raises(RequestError) as caught:
        ask(agent)
    said = "it redirects to http://127.0.0.1:1/" if status == 302 else "no way"
    assert str(caught.value) == f"{MODEL} at {server.url} gave no answer: status {status}: {said}"
    assert waits(agent) == []


def test_faults_without_end_give_up(server: ChatServer, make_agent: MakeAgent) -> None:
    """After as many retries as were allowed."""
    server.otherwise = error(503, "loading")
    agent = make_agent(max_retries=3)
    with pytest.raises(RequestError, match=r"gave no answer: status 503: loading \(4 attempts\)$") as caught:
        ask(agent)
    assert caught.value.cause == "server"
    assert waits(agent) == [0.5, 1.0, 2.0]


def test_retry_after_is_honoured_in_seconds_and_as_a_date(server: ChatServer, make_agent: MakeAgent) -> None:
    """With half a second of chance, so that not all come back at once."""
    agent = make_agent(timeout_s=1e9)
    date = formatdate(time.time() + 1e6, usegmt=True)
    server.script = [error(429, "x", **{"Retry-After": "7"}), error(503, "x", **{"Retry-After": date})]
    assert ask(agent) == "ok"
    assert waits(agent) == [7.5, pytest.approx(1e6, abs=1e4)]


def test_a_wait_beyond_the_deadline_ends_the_request(server: ChatServer, make_agent: MakeAgent) -> None:
    """At once, since the answer is known."""
    server.otherwise = error(429, "busy", **{"Retry-After": "60"})
    agent = make_agent(timeout_s=30)
    with pytest.raises(
        RequestError, match=r"status 429: busy, and it asks to wait 60 s; the time for this request is up$"
    ) as caught:
        ask(agent)
    assert caught.value.cause == "rate_limit"
    assert (waits(agent), len(server.chats)) == ([], 1)


async def hang(request: Request) -> Reply:
    """Never answer."""
    await asyncio.Event().wait()
    raise AssertionError


@pytest.mark.parametrize("limits", ["the agent's", "the turn's"])
def test_the_deadline_holds(server: ChatServer, make_agent: MakeAgent, limits: str) -> None:
    """A server that hangs is left."""
    server.otherwise = hang
    agent = make_agent(timeout_s=0.2) if limits == "the agent's" else make_agent()
    deadline = None if limits == "the agent's" else time.monotonic() + 0.2
    with pytest.raises(RequestError, match=r"no answer within 0 s; the time for this request is up$|deadline passed"):
        ask(agent, deadline=deadline)
    assert waits(agent) == []


def test_a_deadline_holds_for_the_wait_for_a_place(server: ChatServer, make_agent: MakeAgent) -> None:
    """Other requests may hold all of them."""
    server.otherwise = hang
    agent = make_agent(max_concurrency=1)

    async def scenario() -> None:
        first = asyncio.ensure_future(agent("x", context()))
        while not server.in_flight:
            await asyncio.sleep(0)
        with pytest.raises(RequestError, match="the deadline passed before a place among the requests was free"):
            await agent("x", context(deadline=time.monotonic() + 0.01))
        first.cancel()

    run_sync(scenario())


def test_an_attempt_that_hangs_is_tried_again(server: ChatServer, make_agent: MakeAgent) -> None:
    """Where attempts have a limit of their own."""
    agent = make_agent(attempt_timeout_s=0.2)
    server.script = [hang]
    assert ask(agent) == "ok"
    assert waits(agent)[0] == 0.5


def test_refused_extras_are_dropped_once_and_remembered(server: ChatServer, make_agent: MakeAgent) -> None:
    """As OpenAI refuses vLLM's, and some models log-probabilities and the old name of max_tokens."""
    server.script = [
        error(400, "Unrecognized request argument supplied: return_token_ids"),
        error(403, "You are not allowed to request logprobs from this model"),
        error(400, "'max_tokens' is not supported with this model. Use 'max_completion_tokens' instead."),
    ]
    agent = make_agent(return_token_ids=True, max_tokens=9)
    assert [ask(agent), ask(agent)] == ["ok", "ok"]
    assert len(server.chats) == 5
    for chat in server.chats[3:]:
        assert {"return_token_ids", "logprobs", "max_tokens"}.isdisjoint(chat)
        assert chat["max_completion_tokens"] == 9


def test_a_history_that_overflows_truncates_and_is_scored(server: ChatServer, make_agent: MakeAgent) -> None:
    """But a first prompt that is too long is an error: it may be a wrong max_tokens."""
    overflow = error(400, "This model's maximum context length is 8 tokens", "context_length_exceeded")
    server.script = [overflow, overflow]
    agent = make_agent()
    with pytest.raises(ContextOverflowError, match="the history is longer than"):
        ask(agent, turn=1)
    with pytest.raises(RequestError, match="maximum context length") as caught:
        ask(agent, turn=0)
    assert not isinstance(caught.value, ContextOverflowError)


# Concurrency.


@pytest.mark.parametrize("most", [5, 64])
def test_as_many_requests_as_allowed_are_in_flight_and_never_more(
    server: ChatServer, make_agent: MakeAgent, most: int
) -> None:
    """The server answers only when so many wait."""
    full = asyncio.Condition()

    async def together(request: Request) -> Reply:
        async with full:
            if server.in_flight == most:
                full.notify_all()
            else:
                await full.wait()
        return Reply(completion())

    async def scenario() -> list[str]:
        agent = make_agent(max_concurrency=most)
        return await asyncio.gather(*[agent("x", context()) for _ in range(most)])

    server.otherwise = together
    assert run_sync(scenario()) == ["ok"] * most
    assert server.peak == most
    server.otherwise = Reply(completion())

    async def crowd() -> None:
        agent = make_agent(max_concurrency=most)
        await asyncio.gather(*[agent("x", context()) for _ in range(3 * most)])

    run_sync(crowd())
    assert server.peak == most


def test_it_can_be_awaited_on_any_loop(server: ChatServer, make_agent: MakeAgent) -> None:
    """One after another, from loops that come and go."""
    agent = make_agent()

    async def twice() -> list[str]:
        return [await agent("x", context()), await agent("y", context())]

    assert asyncio.run(twice()) + asyncio.run(twice()) == ["ok"] * 4
