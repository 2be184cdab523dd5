"""The tool ``mcp`` with a server that misbehaves in every way, one at a time."""

from __future__ import annotations

import asyncio
import pickle
import re
import sys
from collections.abc import Iterator

import pytest
from mcp_helping import BAD_SERVER, action, around, bad, question, servers_of, step, wait_until_no_server_runs

import gem_core as gem
from gem_core.background import run_sync
from gem_core.errors import ArgumentError, MissingRequirementError
from gem_core.testing import check_tool
from gem_core.tools import ToolEnv
from gem_tools.mcp.connection import ServerFault
from gem_tools.mcp.tool import make_mcp


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    """Every server is gone after its test."""
    yield
    wait_until_no_server_runs()


@pytest.fixture
def env() -> Iterator[ToolEnv]:
    """A task with the tools of a server that behaves."""
    env = around(bad())
    yield env
    env.close()


def test_tools_of_a_server_are_tools_of_the_environment():
    env = around(bad(include=["echo", "count"]))
    observation, info = env.reset(seed=0)
    assert "- echo: Does echo. Call it with <echo>text</echo>; its arguments, as a JSON Schema: {" in observation
    assert [tool["function"]["name"] for tool in info["tools"]] == ["echo", "count"]
    assert info["tools"][0]["function"]["parameters"] == {
        "type": "object",
        "properties": {"text": {"type": "string"}},
        "required": ["text"],
        "additionalProperties": False,
    }
    observation, info = step(env, "echo", text="hällo")
    assert observation == "hällo"
    assert (info["server"], info["server_tool"], info["failed"]) == ("bad", "echo", False)
    assert "hi" in env.step("<echo>hi</echo>")[0]
    call = {"id": "c1", "type": "function", "function": {"name": "echo", "arguments": '{"text": "native"}'}}
    messages = env.step(gem.Response("", tool_calls=[call]))[4]["messages"]
    assert messages[0]["tool_call_id"] == "c1"
    assert "native" in messages[0]["content"]
    env.close()


def test_arguments_that_cannot_be_sent_do_not_reach_the_server(env):
    assert step(env, "echo", text="\ud800")[1]["failed"]
    assert step(env, "count")[0] == "1"


def test_the_tools_of_a_server_share_a_session_in_an_episode(env):
    assert [step(env, "count")[0], step(env, "echo", text="x")[0], step(env, "count")[0]] == ["1", "x", "3"]
    assert len(servers_of()) == 1
    env.reset(seed=1)
    wait_until_no_server_runs()
    assert step(env, "count")[0] == "1"


def test_a_shared_session_is_one_for_all_environments_until_the_last_is_gone():
    one, other = around(bad(sessions="shared")), around(bad(sessions="shared"))
    assert [step(one, "count")[0], step(other, "count")[0]] == ["1", "2"]
    one.reset(seed=1)
    assert step(one, "count")[0] == "3"
    assert len(servers_of()) == 1
    one.close()
    other.close()
    del one
    assert step(around(bad(sessions="shared")), "count")[0] == "4"
    del other
    wait_until_no_server_runs()


def test_every_kind_of_content_becomes_an_observation(env):
    observation, info = step(env, "shapes")
    shown = [part["text"] if part["type"] == "text" else part["image"].size for part in observation]
    assert shown[1:-1] == [
        "words",
        (1, 1),
        "[image that cannot be read, image/png, 9 bytes: cannot be shown as text]",
        "[audio, audio/wav, 3 bytes: cannot be shown as text]",
        "[resource notes:///a: A, text/plain]",
        "[resource notes:///b]\ninside",
        "[resource notes:///c, application/zip, 3 bytes: cannot be shown as text]",
        "[something new: cannot be shown as text]\n",
    ]
    assert info["structured"] == {"n": 1}


# Faults.


@pytest.mark.thorough
def test_a_slow_call_is_given_up_and_the_session_goes_on():
    env = around(bad(call_timeout_s=3.0))
    observation, info = step(env, "slow")
    assert "did not answer within 3 s" in observation
    assert "fault" not in info  # a call may ask for what takes long
    assert step(env, "cancelled")[0] == "1"  # the server was told
    assert step(env, "count")[0] == "3"
    env.close()


def test_a_server_that_dies_is_restarted_and_the_agent_is_told(tmp_path):
    """The call is not repeated: it may have had its effect."""
    log = tmp_path / "calls"
    env = around(bad("log", env={"CALLS": str(log)}))
    assert step(env, "count")[0] == "1"
    observation, info = step(env, "die")
    assert "the server has ended (its standard error ends with: I was told to die)" in observation
    assert info["fault"].startswith("died: ")
    observation, info = step(env, "count")
    assert observation == "[The server bad was restarted before this call: what the server remembered may be lost.]\n1"
    assert info["restarted"]
    assert step(env, "count")[0] == "2"
    assert log.read_text().split() == ["count", "die", "count", "count"]
    env.close()


def test_a_code_of_a_server_says_nothing_of_the_connection(env):
    """Servers answer with the codes by which the library tells of lost connections and of its clock."""
    for code in (-32000, -32001, -32700, -32600):
        observation, info = step(env, "error", code=code)
        assert observation == "The server bad refused the call: as asked"
        assert "fault" not in info
    assert step(env, "count")[0] == "5"  # nothing was restarted


def test_a_server_that_hangs_costs_each_call_its_limit():
    env = around(bad("deaf", call_timeout_s=0.5))
    assert step(env, "count")[0] == "1"
    assert "did not answer within 0.5 s" in step(env, "echo", text="x" * 1_000_000)[0]  # more than a pipe holds
    env.reset(seed=1)
    assert step(env, "count")[0] == "1"
    env.close()


def test_a_session_has_a_folder_of_its_own(tmp_path):
    """It outlives a restart of the server, is empty in the next episode, and is deleted."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    options = {"env": {"NOTES": "{episode_dir}/notes"}, "cwd": "{episode_dir}"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tempfile.tempdir", str(folder))
        env = around(bad(**options))
        assert step(env, "note")[0] == "1 True"
        step(env, "die")
        assert step(env, "note")[0].endswith("\n2 True")
        env.reset(seed=1)
        assert step(env, "note")[0] == "1 True"
        env.close()
    assert list(folder.iterdir()) == []


def test_answers_that_are_too_long_are_not_read():
    """The server is started again: nobody knows which call it answered."""
    env = around(bad(max_chars=500))
    observation, _ = step(env, "blob", size=50_000)
    assert len(observation) == 500
    assert "50,000 characters" in observation
    assert "over 10,000,000 bytes" in step(env, "blob", size=10_000_000)[0]
    assert step(env, "count")[0].endswith("may be lost.]\n1")
    env.close()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("way", "tool", "said"), [("", "ask", "not supported"), ("wrong-ids", "count", "within 0.5 s")]
)
def test_what_a_server_must_not_do_comes_to_nothing(way, tool, said):
    """It asks for a completion, or answers what nobody asked."""
    env = around(bad(way, call_timeout_s=0.5))
    assert said in step(env, tool)[0]
    env.close()


@pytest.mark.thorough
@pytest.mark.parametrize("way", ["garbage", "modern", "pages"])
def test_servers_may_be_odd(way):
    """They write what is no message, know only the newest version of the protocol, or list their tools in pages."""
    env = around(bad(way))
    assert step(env, "echo", text="x")[0] == "x"
    assert step(env, "no-such-tool")[1]["failed"]
    env.close()


@pytest.mark.thorough
def test_odd_names_and_schemas_cost_only_what_is_odd():
    env = around(bad("duplicates", "wrong-schema"))
    names = list(env.tools)
    assert names.count("echo") == 1
    assert {"odd_n_me_with_slashes", "odd_n_me_with_slashes_2"} < set(names)
    assert step(env, "odd_n_me_with_slashes_2")[0] == "no tool odd näme? with/slashes"
    assert step(env, "echo", text=3)[0] == "3"
    assert step(env, "count", anything=1)[0] == "3"
    env.close()
    assert len(make_mcp(**bad("endless-pages")[1])) == 1000


def test_two_servers_with_the_same_tools_are_told_apart():
    config = {name: {"command": sys.executable, "args": ["-S", BAD_SERVER]} for name in ("one", "two")}
    env = around(("mcp", {"config": {"mcpServers": config}}))
    assert [step(env, name)[0] for name in ("one_count", "one_count", "two_count")] == ["1", "2", "1"]
    env.close()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("way", "message"),
    [
        ("die-at-start", "ended before it had answered; its standard error ends with: cannot open"),
        ("mute", "did not answer within 2 s; give it more with connect_timeout_s"),
        ("flood", "did not answer within 2 s"),
        ("refuse", "refused the connection: not today"),
        ("no-list", "I keep this to myself"),
    ],
)
def test_a_server_that_does_not_start_is_an_error_that_says_why(way, message):
    with pytest.raises(ServerFault, match=f"^the MCP server 'bad' .* {re.escape(message)}"):
        make_mcp(**bad(way, connect_timeout_s=2 if way in ("mute", "flood", "no-list") else 60)[1])


def test_a_program_that_is_not_there_is_an_error_that_says_so():
    with pytest.raises(MissingRequirementError, match="no-such-program"):
        make_mcp(command="no-such-program")
    with pytest.raises(ArgumentError, match="there are echo, count"):
        make_mcp(**bad(include=["nothing"])[1])


def test_servers_get_none_of_our_secrets(monkeypatch):
    """And what they were given is blotted out of what they say."""
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    monkeypatch.setenv("LANG", "C.UTF-8")
    shown = "import os; print({name: value for name, value in os.environ.items() if name not in ('PATH', 'USER')})"
    command = f"import sys; sys.stdout = sys.stderr; {shown}"
    with pytest.raises(ServerFault) as caught:
        make_mcp(command=sys.executable, args=["-c", command], env={"HOME": "/x", "TOKEN": "s3cret-s3cret"})
    assert all(said in str(caught.value) for said in ("'LANG': 'C.UTF-8'", "'HOME': '/x'", "'TOKEN': '***'"))
    assert "OPENAI" not in str(caught.value)


# Where it is called from.


@pytest.mark.thorough
def test_inside_a_running_loop():
    """Made, stepped and closed on a loop of the caller's; made on the library's, where to wait for it would not end."""

    async def play() -> str:
        env = around(bad())
        observation = (await env.step_async(action("echo", {"text": "x"})))[0]
        await asyncio.gather(*(env.step_async(action("count", {})) for _ in range(3)))
        env.close()
        return observation

    assert "x" in asyncio.run(play())

    async def make() -> ToolEnv:
        return ToolEnv(question(), [bad(env={"UNIQUE": "on the loop"})], max_tool_uses=None)

    env = run_sync(make())
    env.reset(seed=0)
    assert step(env, "count")[0] == "1"
    env.close()


@pytest.mark.thorough
def test_tools_keep_their_promises_and_go_to_another_process():
    tools = make_mcp(**bad(include=["count", "echo"])[1])
    assert len(check_tool(tools[0], {"text": "x"})) > 5
    env = around(*pickle.loads(pickle.dumps(tools)))
    assert [step(env, "count")[0], step(env, "count")[0]] == ["1", "2"]
    assert len(servers_of()) == 1
    env.close()
