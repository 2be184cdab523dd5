"""The agent that asks a model server, where the server means no good or the surroundings are odd."""

from __future__ import annotations

import json
import traceback
from pathlib import Path
from typing import Any

import pytest
from chat_server import KEY, ChatServer, MakeAgent, Reply, ask, completion, error
from PIL import Image
from toys import CountdownEnv

import gem_core as gem
from gem_core.background import run_sync
from gem_core.errors import ContextOverflowError, RequestError
from gem_core.records import EpisodeWriter, read_episodes

NESTED = b"[" * 900 + b"]" * 900
VERY_NESTED = b"[" * 100_000 + b"]" * 100_000


def with_raw(whole: dict[str, Any], raw: bytes) -> Reply:
    """Return an answer in which the text RAW is something that ``json`` would not write."""
    return Reply(json.dumps(whole).encode().replace(b'"RAW"', raw))


@pytest.mark.parametrize("raw", [b"NaN", b"-Infinity", b"1e999", NESTED, VERY_NESTED])
@pytest.mark.parametrize("place", ["usage", "call", "arguments", "logprobs", "token_ids"])
def test_what_no_record_can_hold_stops_no_run(
    server: ChatServer, make_agent: MakeAgent, tmp_path: Path, raw: bytes, place: str
) -> None:
    """Numbers that are none, and values nested without end."""
    whole = completion("ok")
    choice, function = whole["choices"][0], {"name": "f", "arguments": {"a": "RAW"} if place == "arguments" else "{}"}
    if place in ("call", "arguments"):
        choice["message"]["tool_calls"] = [{"id": "a", "function": function, "more": "RAW" if place == "call" else ""}]
    choice |= {"logprobs": {"content": [{"token": "a", "logprob": "RAW"}]}} if place == "logprobs" else {}
    choice |= {"token_ids": ["RAW"]} if place == "token_ids" else {}
    whole["usage"] = {"prompt_tokens": 1, "more": "RAW" if place == "usage" else 1}
    server.otherwise = with_raw(whole, raw)
    agent = make_agent(max_retries=1)
    with EpisodeWriter(tmp_path / "a.jsonl") as writer:
        for episode in gem.rollout(CountdownEnv(), agent, episodes=1, seed=1):
            writer.write(episode)
    assert len(list(read_episodes(tmp_path / "a.jsonl"))) == 1


def test_an_answer_without_end_is_given_up(
    server: ChatServer, make_agent: MakeAgent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a number of bytes, and it is not asked for again."""
    monkeypatch.setattr("gem_openai.client.MAX_ANSWER_BYTES", 100_000)
    server.otherwise = Reply(b" " * 50_000_000, headers={"Content-Type": "text/event-stream"})
    before = len(server.chats)
    with pytest.raises(RequestError, match="more than 100,000 bytes"):
        ask(make_agent(max_retries=3))
    assert len(server.chats) == before + 1


def test_the_key_is_in_no_frame_of_a_failure(server: ChatServer, make_agent: MakeAgent) -> None:
    """Tools that report errors show the local variables of every frame, of suppressed contexts too."""
    server.otherwise = error(400, "no")
    with pytest.raises(RequestError) as caught:
        ask(make_agent(max_retries=0))
    seen: list[BaseException] = []
    left: list[BaseException | None] = [caught.value]
    while left:
        one = left.pop()
        if one is None or one in seen:
            continue
        seen.append(one)
        left += [one.__cause__, one.__context__]
        shown = traceback.TracebackException.from_exception(one, capture_locals=True)
        assert not [frame.name for frame in shown.stack if KEY in str(frame.locals) and "/tests/" not in frame.filename]


def test_usage_is_asked_for_after_a_start_without_streaming(server: ChatServer, make_agent: MakeAgent) -> None:
    """The request of the start is not streamed, and servers refuse stream_options there."""
    server.models = error(404, "none here")
    agent = make_agent(stream=True)
    server.script = [error(400, "The 'stream_options' parameter is only allowed when 'stream' is enabled.")]
    run_sync(agent.prepare())
    assert "stream_options" not in server.chats[0]


def test_a_short_key_hides_nothing_that_matters(
    server: ChatServer, make_agent: MakeAgent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Local servers are given any word for a key."""
    monkeypatch.setenv("OPENAI_API_KEY", "x")
    server.otherwise = error(400, "This model's maximum context length is 10 tokens.")
    with pytest.raises(ContextOverflowError):
        ask(make_agent(max_retries=0), turn=3)


def test_images_of_tools_follow_as_a_message_of_the_user(server: ChatServer, make_agent: MakeAgent) -> None:
    """The API takes only text in the messages of tools, and these right behind the calls."""
    picture = {"type": "image", "image": Image.new("RGB", (2, 2))}
    calls = [{"id": i, "type": "function", "function": {"name": "f", "arguments": "{}"}} for i in "ab"]
    ask(
        make_agent(),
        [
            {"role": "user", "content": "look"},
            {"role": "assistant", "content": "", "tool_calls": calls},
            {"role": "tool", "tool_call_id": "a", "content": [{"type": "text", "text": "one"}, picture]},
            {"role": "tool", "tool_call_id": "b", "content": [picture]},
        ],
    )
    messages = server.chats[0]["messages"]
    assert [message["role"] for message in messages] == ["user", "assistant", "tool", "tool", "user"]
    assert messages[2]["content"] == [{"type": "text", "text": "one"}]
    assert messages[3]["content"] == "(an image, shown below)"
    assert [part["type"] for part in messages[4]["content"]] == ["image_url", "image_url"]


def test_the_proxy_of_the_environment_is_used(
    server: ChatServer, make_agent: MakeAgent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Except for hosts that need none, and this machine."""
    monkeypatch.setenv("http_proxy", server.url.replace("//", "//me:pass@").removesuffix("/v1"))
    monkeypatch.setenv("no_proxy", "near.invalid")
    assert ask(make_agent(base_url="http://far.invalid/v1", max_retries=0)) == "ok"
    (request,) = server.requests
    assert request.path == "http://far.invalid/v1/chat/completions"
    assert request.headers["proxy-authorization"].startswith("Basic ")
    with pytest.raises(RequestError, match=r"no host of this name|no connection"):
        ask(make_agent(base_url="http://near.invalid/v1", max_retries=0))
    assert ask(make_agent()) == "ok"


@pytest.mark.parametrize("url", ["http://[::1/v1", "http://a..b/v1", f"http://{'a' * 64}/v1"])
def test_hosts_that_cannot_be_are_refused_at_the_start(make_agent: MakeAgent, url: str) -> None:
    """Else the look-up raises what is no error of ours."""
    with pytest.raises(gem.errors.ArgumentError, match="the base URL must look like"):
        make_agent(base_url=url)


def test_names_of_models_are_shown_on_one_line(server: ChatServer, make_agent: MakeAgent) -> None:
    """Whatever a server calls them."""
    server.models = Reply({"data": [{"id": "a\n\x1b[31mb"}]})
    server.otherwise = error(404, "no such model", "model_not_found")
    with pytest.raises(gem.errors.UnknownModelError) as caught:
        run_sync(make_agent(max_retries=0).prepare())
    assert str(caught.value).isprintable()


def test_passwords_in_netrc_are_neither_sent_nor_in_the_way(
    server: ChatServer, make_agent: MakeAgent, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A default entry holds for every host."""
    netrc = tmp_path / "netrc"
    netrc.write_text("default login me password other\n")
    netrc.chmod(0o600)
    monkeypatch.setenv("NETRC", str(netrc))
    url = server.url.replace("127.0.0.1", "0.0.0.0")  # not known as this machine
    assert ask(make_agent(base_url=url)) == "ok"
    monkeypatch.delenv("OPENAI_API_KEY")
    assert ask(make_agent(base_url=url)) == "ok"
    assert [request.headers.get("authorization") for request in server.requests] == [f"Bearer {KEY}", None]
