"""Searching on servers: what is sent and read, retries, limits, and a key that is never shown."""

from __future__ import annotations

import asyncio
import logging
import pickle
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from search_server import Reply, Server, serving

from gem_core.background import run_sync
from gem_core.errors import ArgumentError, MissingRequirementError
from gem_core.testing import check_tool
from gem_core.tools import ToolResult
from gem_tools.search import remote
from gem_tools.search.passages import Passage
from gem_tools.search.remote import SearchFault, read_retrieved, read_serper
from gem_tools.search.tool import RemoteSearch, make_search

KEY = "secret+key/0123456789"
ONE = {"result": [[{"document": {"id": "7", "contents": '"A Title"\nits text'}, "score": 1.5}]]}
SHOWN = "[1] A Title\nits text"


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SERPER_API_KEY", KEY)
    monkeypatch.delenv("SEARCH_URL", raising=False)


@pytest.fixture
def server() -> Iterator[Server]:
    with serving(Reply(ONE)) as running:
        yield running


def tool_for(server: Server, engine: str = "retrieve", **options: Any) -> tuple[RemoteSearch, list[float]]:
    """Return a tool that waits for nothing, and the list of the waits that it would have had."""
    tool = make_search(engine, url=f"{server.url}/path", **options)
    assert isinstance(tool, RemoteSearch)
    waits: list[float] = []

    async def sleep(seconds: float) -> None:
        waits.append(seconds)

    tool.server.sleep = sleep  # type: ignore[assignment]
    return tool, waits


def call(tool: Any, query: str = "what") -> ToolResult:
    return run_sync(tool.call(tool.Parameters(query=query), None))


def test_a_retrieval_server_is_asked_in_the_form_of_search_r1(server: Server) -> None:
    """One query, always with scores, since the servers fail without."""
    tool, _ = tool_for(server, top_k=2)
    row = {"id": "7", "title": "A Title", "score": 1.5, "url": ""}
    assert call(tool, " what\nnow ") == ToolResult(SHOWN, info={"engine": "retrieve", "results": [row]})
    ((path, _, body),) = server.requests
    assert (path, body) == ("/path", {"queries": ["what now"], "topk": 2, "return_scores": True})


def test_an_address_without_a_path_gets_that_of_search_r1(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """Given, or in the environment."""
    call(make_search(url=server.url))
    monkeypatch.setenv("SEARCH_URL", f"{server.url}/")
    call(make_search("retrieve"))
    assert [path for path, *_ in server.requests] == ["/retrieve", "/retrieve"]


@pytest.mark.parametrize(
    "answer",
    [
        {"result": [[{"document": {"contents": '"T"\nx'}, "score": 1}]]},
        {"result": [[{"contents": "T\nx"}]]},
        {"result": [["T\nx"]]},
        {"result": [{"document": "T\nx"}]},
        {"result": [[{"document": {"title": "T", "text": "x", "contents": "y"}, "score": float("nan")}, 5, None, {}]]},
    ],
)
def test_the_dialects_of_retrieval_servers_are_read(answer: Any) -> None:
    """With and without scores, titles, and lists within lists."""
    (passage,) = read_retrieved(answer)
    assert (passage.title, passage.text) == ("T", "x")


def test_serper_is_asked_with_its_key_in_a_header() -> None:
    """And the answer that it puts above the results comes first."""
    answer = {
        "answerBox": {"title": "Box", "answer": "42", "link": "http://a.example"},
        "organic": [{"title": "One", "snippet": "first", "link": "http://b.example", "position": 1}, "junk"],
    }
    with serving(Reply(answer)) as server:
        result = call(tool_for(server, "serper")[0])
    assert result.content == "[1] Box (http://a.example)\n42\n\n[2] One (http://b.example)\nfirst"
    ((_, headers, body),) = server.requests
    assert (headers["X-API-KEY"], body) == (KEY, {"q": "what", "num": 3})


KEYS = ["result", "document", "contents", "organic", "answerBox", "title", "snippet", "score", "id"]
json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=4),
    max_leaves=12,
)


@given(st.sampled_from([read_retrieved, read_serper]), json_values)
def test_any_answer_is_read(read: Callable[[Any], list[Passage]], answer: Any) -> None:
    """As passages, or refused; nothing else."""
    try:
        passages = read(answer)
    except SearchFault:
        return
    assert all(isinstance(passage, Passage) for passage in passages)


# Faults.


@pytest.mark.parametrize("status", [429, 500, 503])
def test_what_may_pass_is_tried_again(status: int) -> None:
    """After waits at random, which grow."""
    with serving(Reply("busy", status), Reply("busy", status), Reply(ONE)) as server:
        tool, waits = tool_for(server)
        assert call(tool).content == SHOWN
    first, second = waits
    assert 0 <= first <= 0.5
    assert 0 <= second <= 1.0


def test_retry_after_is_heeded() -> None:
    """With a little chance on top, so that not all come back in one instant."""
    with serving(Reply("slow", 429, {"Retry-After": "7"}), Reply(ONE)) as server:
        tool, waits = tool_for(server)
        call(tool)
    (wait,) = waits
    assert 7.0 <= wait <= 7.5


def test_a_longer_wait_than_the_time_limit_ends_the_search() -> None:
    """At once."""
    with serving(Reply({"error": {"message": "quota"}}, 429, {"Retry-After": "1000"})) as server:
        tool, waits = tool_for(server)
        assert call(tool).info["fault"].startswith("status 429: quota")
    assert waits == []
    assert len(server.requests) == 1


@pytest.mark.parametrize(
    ("reply", "fault"),
    [
        (Reply({"message": "Unauthorized."}, 403), "status 403: Unauthorized."),
        (Reply(b"", 404), "status 404: Not Found"),
        (Reply(b"", 302, {"Location": "http://elsewhere.example"}), "status 302: it redirects elsewhere"),
        (Reply({"other": 1}), "the answer has no list under 'result'"),
        (Reply(b"[" * 200_000), "the answer is no JSON (2 attempts)"),
        (Reply(b"\x1b[2J\n" * 300, 400), f"status 400: {('[2J ' * 300)[:200]}…"),
        (Reply("down", 500), "status 500: down (2 attempts)"),
        (Reply(None, 0), "the connection broke (ServerDisconnectedError) (2 attempts)"),
    ],
)
def test_a_server_that_fails_is_an_observation(reply: Reply, fault: str) -> None:
    """It says whose fault it is, and is known to trainers as a fault of the machine."""
    with serving(reply) as server:
        result = call(tool_for(server, max_retries=1)[0])
    assert result.failed
    assert result.info == {"engine": "retrieve", "fault": fault, "results": []}
    assert fault in str(result.content)


def test_an_unreachable_server_is_an_observation() -> None:
    """Nobody listens on a port that was just given back."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    tool = make_search(url=f"http://127.0.0.1:{port}", max_retries=0)
    assert call(tool).info["fault"] == "no connection (connection refused)"


def test_an_endless_answer_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before it fills the memory."""
    monkeypatch.setattr(remote, "MAX_ANSWER_BYTES", 1_000_000)
    with serving(Reply(b"x" * 3_000_000)) as server:
        assert "1 MB" in call(tool_for(server)[0]).info["fault"]


def test_a_hung_server_is_given_up() -> None:
    """After the time limit of the search."""
    with serving(Reply(ONE)) as server:
        server.held = asyncio.Event()
        tool = make_search(url=server.url, timeout_s=0.2)
        assert call(tool).info["fault"] == "no answer in time"

        async def let_go(event: asyncio.Event) -> None:
            event.set()

        run_sync(let_go(server.held))


# Keys.


def test_no_key_is_ever_shown(caplog: pytest.LogCaptureFixture) -> None:
    """Not in results, faults, representations, pickles or the log, though the server throws it back."""
    caplog.set_level(logging.DEBUG)
    row = {"title": f"a {KEY}", "snippet": KEY, "link": f"http://x.example/?k={KEY}"}
    bad = Reply(f"bad key {KEY} secret%2Bkey%2F0123456789 secret%2Bkey/0123456789", 401)
    with serving(Reply({"organic": [row]}), bad, Reply(None, 0)) as server:
        tool, _ = tool_for(server, "serper", max_retries=0)
        seen = [repr(call(tool, query)) for query in ("one", "two", "three")]
    with pytest.raises(SearchFault) as caught:
        run_sync(tool.server.search("four", 3))
    seen += [repr(tool), repr(tool.server), str(vars(tool.server)), str(pickle.dumps(tool)), caplog.text]
    seen.append(repr(caught.value) + repr(caught.value.__cause__) + repr(caught.value.__context__))
    assert [text for text in seen if KEY in text or "secret" in text] == []
    assert "bad key *** *** ***" in seen[1]


def test_a_missing_key_is_told_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the variable to set; one that goes missing later is a fault."""
    with serving(Reply({})) as server:
        tool, _ = tool_for(server, "serper")
        monkeypatch.setenv("SERPER_API_KEY", " ")
        assert "SERPER_API_KEY" in call(tool).info["fault"]
    with pytest.raises(MissingRequirementError, match="SERPER_API_KEY"):
        make_search("serper", timeout_s=7)
    monkeypatch.setenv("SERPER_API_KEY", "line\nbreak")
    with pytest.raises(ArgumentError):
        make_search("serper", timeout_s=7)


def test_the_tool_keeps_its_promises(server: Server) -> None:
    """Those of every tool."""
    assert check_tool(make_search(url=server.url), {"query": "x"})


@pytest.mark.parametrize(
    ("url", "proxy"),
    [
        ("http://name:password@corp.example:8000/retrieve", None),
        ("http://[::1]:8000/retrieve", None),
        ("http://other.example/retrieve", "http://proxy.example:3128"),
    ],
)
def test_the_environment_names_the_proxy(monkeypatch: pytest.MonkeyPatch, url: str, proxy: str | None) -> None:
    """And who is reached without one, also if the address holds a password."""
    for name in ("http_proxy", "https_proxy", "no_proxy", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.upper(), raising=False)
    monkeypatch.setenv("http_proxy", "http://proxy.example:3128")
    monkeypatch.setenv("no_proxy", "corp.example")
    assert remote.proxy_for(url) == proxy
