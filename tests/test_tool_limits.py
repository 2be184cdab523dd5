"""Calls that take too long or that the machinery fails: what the agent is told, and what becomes of the session."""

from __future__ import annotations

import asyncio
import gc
import threading
from typing import Any

import pytest
from toys import AsyncNotebook, Calculator, CountdownEnv, EchoEnv, Notebook

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_core.tools import sessions as tool_sessions
from gem_core.tools.env import ToolEnv

LIMIT_S = 0.05
PATIENCE_S = 30.0


class Stuck(Notebook):
    """Waits, where it is told to, until it is let go; in a thread that nobody can stop."""

    def __init__(self, where: str = "call", needs: Any = "inline") -> None:
        super().__init__()
        self.where = where
        self.concurrency = needs
        self.go_on = threading.Event()
        self.over = threading.Event()

    def open(self) -> list[str]:
        session = super().open()
        self._wait("open")
        return session

    def call(self, arguments: Any, session: list[str]) -> gem.ToolResult:
        if arguments.line == "wait":
            self._wait("call")
        return super().call(arguments, session)

    def close(self, session: list[str]) -> None:
        self._wait("close")
        super().close(session)
        self.over.set()

    def _wait(self, where: str) -> None:
        if where == self.where:
            self.go_on.wait()


class AsyncStuck(AsyncNotebook):
    """Waits for ever in a coroutine, and notes that it was cancelled."""

    def __init__(self) -> None:
        super().__init__()
        self.cancelled = 0
        self.over = threading.Event()

    async def call(self, arguments: Any, session: list[str]) -> gem.ToolResult:  # type: ignore[override]  # as in toys
        if arguments.line == "wait":
            try:
                await asyncio.get_running_loop().create_future()
            finally:
                self.cancelled += 1
        return Notebook.call(self, arguments, session)

    async def close(self, session: list[str]) -> None:  # type: ignore[override]  # as in toys
        Notebook.close(self, session)
        self.over.set()


def limited(*tools: gem.Tool, limit_s: float = LIMIT_S) -> ToolEnv:
    env = ToolEnv(CountdownEnv(), list(tools), call_timeout_s=limit_s, max_tool_uses=None)
    env.reset(seed=1, options={"left": 9})
    return env


@pytest.mark.parametrize("needs", ["inline", "thread"])
def test_a_call_that_hangs_is_told_and_left_behind(needs: str) -> None:
    """The next call has a new session; the old one is closed once its call ends."""
    tool = Stuck(needs=needs)
    env = limited(tool)
    env.step("<note>a</note>")
    observation, _, terminated, truncated, info = env.step("<note>wait</note>")
    assert observation.startswith(
        "Error from note:\nThe tool did not answer within 0.05 s, and the call was given up. What it remembered of "
        "this episode is lost.\nYou may call a tool again"
    )
    assert (terminated, truncated) == (False, False)
    assert (info["tool"]["failed"], info["tool"]["timed_out"], info["tool"]["failures"]) == (True, True, 1)
    assert (tool.opened, tool.closed) == (1, 0)
    env._sessions.timeout_s = PATIENCE_S
    assert "Output of note:\nb\n" in env.step("<note>b</note>")[0]
    tool.go_on.set()
    assert tool.over.wait(PATIENCE_S)
    assert (tool.opened, tool.closed) == (2, 1)
    env.close()
    assert tool.closed == 2


def test_a_coroutine_that_hangs_is_cancelled() -> None:
    """And its session is closed behind it."""
    tool = AsyncStuck()
    env = limited(tool)
    assert "The tool did not answer within 0.05 s" in asyncio.run(env.step_async("<note>wait</note>"))[0]
    assert tool.over.wait(PATIENCE_S)
    assert (tool.cancelled, tool.opened, tool.closed) == (1, 1, 1)
    env.close()


def test_a_session_that_cannot_be_opened_in_time_is_not_the_episodes() -> None:
    """When it opens after all, it is closed."""
    tool = Stuck("open")
    env = limited(tool)
    observation = env.step("<note>a</note>")[0]
    assert "the call was given up.\n" in observation
    tool.go_on.set()
    assert tool.over.wait(PATIENCE_S)
    env._sessions.timeout_s = PATIENCE_S
    assert "Output of note:\nb\n" in env.step("<note>b</note>")[0]
    env.close()
    assert (tool.opened, tool.closed) == (2, 2)


def test_a_session_that_does_not_close_in_time_holds_up_nothing(caplog: pytest.LogCaptureFixture) -> None:
    """It is said in the log."""
    tool = Stuck("close")
    env = limited(tool, limit_s=PATIENCE_S)
    env.step("<note>a</note>")
    env._sessions.timeout_s = LIMIT_S
    env.reset(seed=2)
    assert caplog.messages == ["gem: closing the session of tool 'note' failed"]
    tool.go_on.set()
    assert tool.over.wait(PATIENCE_S)
    env.close()


def test_only_so_many_calls_are_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Then no more of that tool are begun, until some have ended; the agent is told each time. Other tools go on."""
    monkeypatch.setattr(tool_sessions, "MOST_LEFT_BEHIND", 2)
    tools = [Stuck() for _ in range(3)]
    envs = [limited(tool) for tool in tools]
    told = [env.step("<note>wait</note>")[0] for env in envs]
    assert ["given up" in text for text in told] == [True, True, False]
    assert "2 earlier calls ran out of time and have not ended, so no more are begun." in told[2]
    other = limited(Calculator(), limit_s=PATIENCE_S)
    call = '<tool_call>{"name": "calculator", "arguments": {"left": 1, "right": 2, "operation": "add"}}</tool_call>'
    assert "Output of calculator" in other.step(call)[0]
    for tool in tools[:2]:
        tool.go_on.set()
        assert tool.over.wait(PATIENCE_S)
    envs[2]._sessions.timeout_s = PATIENCE_S
    assert "Output of note" in envs[2].step("<note>b</note>")[0]
    for env in (*envs, other):
        env.close()


def test_calls_that_end_in_time_are_as_without_a_limit() -> None:
    """Results, failures and sessions, for plain tools and coroutines side by side."""

    class Other(AsyncNotebook):
        name = "other"

    plain = ToolEnv(CountdownEnv(), [Calculator(), Notebook()], max_tool_uses=None)
    plain.reset(seed=1, options={"left": 9})
    env = limited(Calculator(), Notebook(), Other(), limit_s=PATIENCE_S)
    calls = [
        "<note>a</note>",
        "<note>b</note>",
        '<tool_call>{"name": "calculator", "arguments": {"left": 1, "right": 0, "operation": "divide"}}</tool_call>',
        "<note>",
    ]
    for call in calls:
        assert env.step(call) == plain.step(call)
    assert "Output of other:\nx\n" in env.step("<other>x</other>")[0]
    env.close()


def test_a_dropped_environment_with_a_limit_closes_its_sessions() -> None:
    """As without one; a call that exits ends neither the loop nor the program."""

    class Leaving(Notebook):
        def call(self, arguments: Any, session: Any) -> Any:
            raise SystemExit(3)

    tool = Leaving()
    env = limited(tool, limit_s=PATIENCE_S)
    assert "SystemExit: 3" in env.step("<note>a</note>")[0]
    del env
    gc.collect()
    assert tool.closed == 1


@pytest.mark.parametrize("limit", [0, -1.0, "2", float("nan")])
def test_a_limit_is_a_number_of_seconds(limit: Any) -> None:
    with pytest.raises(ArgumentError, match="call_timeout_s"):
        ToolEnv(EchoEnv(), [Notebook()], call_timeout_s=limit)


def test_the_failure_of_the_machinery_is_not_the_agents() -> None:
    """A call with a fault is told, and is a use, but no error that is paid for."""

    class Broken(Notebook):
        def call(self, arguments: Any, session: list[str]) -> gem.ToolResult:
            return gem.ToolResult("No sandbox could be started.", failed=True, info={"fault": "no memory"})

    env = ToolEnv(CountdownEnv(), [Broken()], tool_error_reward=-0.5, max_tool_uses=3)
    env.reset(seed=1, options={"left": 9})
    for uses in (1, 2):
        observation, reward, _, _, info = env.step("<note>a</note>")
        assert str(observation).startswith(
            f"Error from note:\nNo sandbox could be started.\nTool calls left: {3 - uses}."
        )
        assert reward == 0.0
        counters = [info["tool"][key] for key in ("failed", "fault", "uses", "successes", "failures")]
        assert counters == [True, "no memory", uses, 0, 0]
