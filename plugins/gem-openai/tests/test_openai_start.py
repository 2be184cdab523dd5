"""What the agent for model servers says at the start, and that it keeps the key to itself."""

from __future__ import annotations

import asyncio
import traceback
from typing import Any

import pytest
from chat_server import KEY, MODEL, ChatServer, MakeAgent, Reply, ask, completion, error, waits

import gem_core as gem
from gem_core.background import run_sync
from gem_core.errors import ArgumentError, MissingRequirementError, UnknownModelError
from gem_openai import OpenAIAgent


def start(agent: OpenAIAgent) -> None:
    run_sync(agent.prepare())


def test_the_start_asks_for_the_models_once(server: ChatServer, make_agent: MakeAgent) -> None:
    """And for nothing else when the model is there."""
    agent = make_agent()
    start(agent)
    start(agent)
    assert [request.path for request in server.requests] == ["/v1/models"]


def test_a_server_that_lists_no_models_is_asked_for_a_token(server: ChatServer, make_agent: MakeAgent) -> None:
    """A complaint about so short a request is an acceptance."""
    server.models = error(404, "no such page")
    server.script = [Reply(completion()), error(400, "too short to be of use")]
    start(make_agent())
    start(make_agent())
    assert [chat["max_tokens"] for chat in server.chats] == [1, 1]


def test_an_unreachable_server_is_told_at_once(server: ChatServer, make_agent: MakeAgent) -> None:
    """Without a second try."""
    server.close()
    agent = make_agent()
    with pytest.raises(MissingRequirementError) as caught:
        start(agent)
    assert str(caught.value) == (
        f"cannot reach {server.url}: connection refused; start the server or correct --base-url"
    )
    assert waits(agent) == []


@pytest.mark.parametrize(
    ("url", "reason"),
    [
        ("https://127.0.0.1:{port}/v1", "no TLS connection; is it http instead of https?"),
        ("http://127.0.0.1:99999/v1", "it is no address"),
    ],
)
def test_a_wrong_address_is_told(make_agent: MakeAgent, url: str, reason: str) -> None:
    """With what may be wrong about it."""

    async def refuse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)
        writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        writer.close()

    listening = run_sync(asyncio.start_server(refuse, "127.0.0.1", 0))
    where = url.format(port=listening.sockets[0].getsockname()[1])
    with pytest.raises(MissingRequirementError) as caught:
        start(make_agent(base_url=where))
    listening.close()
    assert str(caught.value) == f"cannot reach {where}: {reason}; start the server or correct --base-url"


def test_a_wrong_key_and_a_missing_key_are_told(
    server: ChatServer, make_agent: MakeAgent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the name of the variable."""
    server.models = error(401, "Incorrect API key provided: sk-abcd****wxyz")
    with pytest.raises(MissingRequirementError) as caught:
        start(make_agent())
    assert str(caught.value) == (
        f"{server.url} refuses the key in OPENAI_API_KEY (status 401: Incorrect API key provided: ***)"
    )
    monkeypatch.delenv("OPENAI_API_KEY")
    with pytest.raises(MissingRequirementError, match="wants a key: set OPENAI_API_KEY"):
        start(make_agent())
    assert "authorization" not in server.requests[-1].headers
    with pytest.raises(MissingRequirementError, match="wants a key: set MY_KEY, or name another server"):
        start(make_agent(base_url="https://api.openai.com/v1", api_key_env="MY_KEY"))


def test_a_refused_model_is_told_with_the_nearest(server: ChatServer, make_agent: MakeAgent) -> None:
    """A model that is not listed may be there all the same."""
    server.models = Reply({"data": [{"id": "toy-modell"}]})
    start(make_agent())
    server.script = [error(404, "The model does not exist", "model_not_found")]
    with pytest.raises(UnknownModelError) as caught:
        start(make_agent())
    assert str(caught.value) == (
        f"{server.url} refuses the model 'toy-model'. Did you mean 'toy-modell'? It has: toy-modell. "
        "(status 404: The model does not exist)"
    )


def test_an_address_without_an_api_is_told(server: ChatServer, make_agent: MakeAgent) -> None:
    """The usual mistake is named."""
    server.models = server.otherwise = error(404, "Not Found")
    with pytest.raises(
        MissingRequirementError, match=r"there is no chat API at .*; correct --base-url, which often ends in /v1"
    ):
        start(make_agent())


# The key.


def test_the_key_is_in_no_exception_and_no_attribute(server: ChatServer, make_agent: MakeAgent) -> None:
    """Also where the server echoes it."""
    echo = f"bad key {KEY}, header Bearer {KEY}"
    agent = make_agent(max_retries=0)
    for reply in (error(401, echo), error(403, echo), error(500, echo), Reply(echo.encode(), 503)):
        server.models = server.otherwise = reply
        for call in (start, ask):
            with pytest.raises(gem.errors.GemError) as caught:
                call(agent)
            assert KEY not in "".join(traceback.format_exception(caught.value))
            assert KEY not in repr(caught.value)
    assert KEY not in repr(agent) + repr(vars(agent)) + repr(vars(agent.client))
    server.otherwise = Reply(completion(f"you sent {KEY}"))
    assert ask(agent) == "you sent ***"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"base_url": f"http://me:{KEY}@localhost"}, "the base URL must look like http://localhost:8000/v1"),
        ({"base_url": f"http://localhost?key={KEY}"}, "the base URL must look like http://localhost:8000/v1"),
        ({"api_key_env": KEY}, "api_key_env is the name of an environment variable"),
        ({"max_concurrency": 0}, "max_concurrency must be a whole number from 1 up, not 0"),
        ({"timeout_s": 0}, "timeout_s must be a number of seconds above 0, not 0"),
        ({"temperature": float("nan")}, "the fields of a request must be plain JSON"),
        ({"extra_body": {"stream": True}}, "extra_body cannot set stream: the agent does"),
    ],
)
def test_wrong_options_are_refused_without_showing_a_key(options: dict[str, Any], message: str) -> None:
    """It may stand where it does not belong."""
    with pytest.raises(ArgumentError, match=message) as caught:
        OpenAIAgent(MODEL, **options)
    assert KEY not in str(caught.value)


def test_a_key_that_no_header_can_hold_is_refused(make_agent: MakeAgent, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not shown."""
    monkeypatch.setenv("OPENAI_API_KEY", f"{KEY}\nX-Evil: 1")
    with pytest.raises(ArgumentError, match="has characters that no key has; set it again") as caught:
        ask(make_agent())
    assert KEY not in str(caught.value)
