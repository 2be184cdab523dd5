"""The tool ``mcp`` over HTTP: what fails is one call, and is told from what may have had its effect."""

from __future__ import annotations

import threading

import pytest
from mcp_helping import around, step
from mcp_web_server import WebServer

from gem_tools.mcp.connection import ServerFault
from gem_tools.mcp.tool import make_mcp

RECONNECTED = (
    "[The connection to the server web was made anew before this call: what the server remembered may be lost.]"
)


def test_a_server_over_http():
    with WebServer(token="t0ken") as server:
        env = around(("mcp", {"url": server.url, "headers": {"Authorization": "Bearer t0ken"}, "server_name": "web"}))
        assert step(env, "echo", a=1)[0] == "{'a': 1}"
        assert server.sessions == 2  # one to ask what it offers, one of the episode
        env.reset(seed=1)
        assert step(env, "echo", a=2)[0] == "{'a': 2}"
        assert server.sessions == 3
        env.close()
        assert server.known == set()  # each was ended


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("tool", "message"),
    [
        ("status", "The server web refused the call: the server answered with status 500 Internal Server Error"),
        ("html", "The server web refused the call: Unexpected content type: text/html"),
        ("accepted", "The server web refused the call: server answered a request with 202 Accepted"),
        ("hang", "The server web was too slow: it did not answer within 3 s."),
        ("huge", "the answer is over 10,000,000 bytes long"),
        ("drop", "The connection to the server web was lost during the call: the connection broke"),
    ],
)
def test_a_call_that_fails_costs_only_itself(tool, message):
    """Nothing is repeated, and the next call is answered."""
    with WebServer() as server:
        options = {"url": server.url, "server_name": "web"}
        env = around(("mcp", options | ({"call_timeout_s": 3.0} if tool == "hang" else {})))
        observation, info = step(env, tool)
        assert message in observation
        assert info["failed"]
        assert server.calls == [tool]
        again = step(env, "echo", a=1)[0]
        assert again == (f"{RECONNECTED}\n{{'a': 1}}" if tool == "drop" else "{'a': 1}")
        assert server.cancelled == (tool == "hang")
        env.close()


def test_a_call_of_a_forgotten_session_fails_and_the_next_is_made_in_a_new_one():
    """The server, which was restarted, has not executed it: it does not know the session."""
    with WebServer() as server:
        env = around(("mcp", {"url": server.url, "server_name": "web"}))
        step(env, "echo", a=1)
        server.forget_sessions()
        assert step(env, "echo", a=2)[0] == (
            "The server web cannot be reached: the server does not know the session any more. This is no fault of your "
            "call."
        )
        observation, info = step(env, "echo", a=3)
        assert observation == f"{RECONNECTED}\n{{'a': 3}}"
        assert info["reconnected"]
        assert "restarted" not in info
        assert server.calls == ["echo", "echo"]
        env.close()


def test_a_server_that_is_down_is_waited_for_at_the_next_call():
    with WebServer() as server:
        port = server.port
        env = around(("mcp", {"url": server.url, "server_name": "web"}))
        step(env, "echo", a=1)
    observation, info = step(env, "echo", a=2)
    assert "was lost during the call: the connection broke (" in observation
    assert "fault" in info
    assert "cannot be reached: " in step(env, "echo", a=2)[0]
    again = WebServer()
    again.port = port
    with again:
        assert step(env, "echo", a=3)[0].endswith("{'a': 3}")
        env.close()


@pytest.mark.parametrize("transport", ["http", "sse"])
def test_an_address_where_nobody_is(transport):
    with WebServer() as server:
        url = server.url.replace("/mcp", f"/{transport}?key=secret")
    message = r"^the MCP server 'web' .* (cannot be used|refused the connection): "
    with pytest.raises(ServerFault, match=message) as caught:
        make_mcp(url=url, transport=transport, server_name="web")
    assert "secret" not in str(caught.value)


def test_a_wrong_key_is_told():
    message = r"refused the connection: the server answered with status 401 Unauthorized"
    with WebServer(token="right") as server, pytest.raises(ServerFault, match=message):
        make_mcp(url=server.url, headers={"Authorization": "Bearer wrong"}, server_name="web")


def test_many_episodes_at_once():
    with WebServer() as server:
        options = {"url": server.url, "server_name": "web", "sessions": "shared"}
        envs = [around(("mcp", options)) for _ in range(8)]
        seen: list[str] = []

        def play(number: int) -> None:
            seen.extend(step(envs[number], "echo", n=number)[0] for _ in range(10))

        threads = [threading.Thread(target=play, args=(number,)) for number in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(seen) == sorted([f"{{'n': {number}}}" for number in range(8)] * 10)
        assert server.sessions == 2
        for env in envs:
            env.close()
