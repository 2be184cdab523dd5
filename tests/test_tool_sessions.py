"""Sessions of tools: who shares one, and what becomes of it when a call takes too long or the machinery fails."""

from __future__ import annotations

import asyncio
import gc
import threading
from typing import Any

import pytest
from toys import AsyncNotebook, Calculator, CountdownEnv, EchoEnv, Notebook

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_core.tools.env import ToolEnv

LIMIT_S = 0.05
PATIENCE_S = 30.0


class Stuck(Notebook):
    """Waits, where it is told to, until it is let go; in a thread that nobody can stop."""

    def __init__(self, where: str) -> None:
        super().__init__()
        self.where = where
        self.go_on, self.over = threading.Event(), threading.Event()

    def call(self, arguments: Any, session: list[str]) -> gem.ToolResult:
        self._wait(arguments.line)
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
        try:
            await asyncio.get_running_loop().create_future()
        finally:
            self.cancelled += 1
        return Notebook.call(self, arguments, session)

    async def close(self, session: list[str]) -> None:  # type: ignore[override]  # as in toys
        Notebook.close(self, session)
        self.over.set()


def tool_env(*tools: gem.Tool, **options: Any) -> ToolEnv:
    env = ToolEnv(CountdownEnv(), list(tools), **{"max_tool_uses": None, **options})
    env.reset(seed=1, options={"left": 9})
    return env


def test_a_call_that_hangs_is_told_and_its_session_given_up() -> None:
    """The next call has a new session."""
    tool = Stuck("call")
    env = tool_env(tool, call_timeout_s=PATIENCE_S)
    assert "Output of note:\na\n" in env.step("<note>a</note>")[0]
    env._sessions.timeout_s = LIMIT_S
    observation, _, terminated, truncated, info = env.step("<note>call</note>")
    assert observation.startswith("Error from note:\nThe tool did not answer within 0.05 s, and the call was given up.")
    assert "is lost" in observation
    assert (terminated, truncated) == (False, False)
    assert (info["tool"]["failed"], info["tool"]["timed_out"], info["tool"]["failures"]) == (True, True, 1)
    assert tool.over.wait(PATIENCE_S)
    env._sessions.timeout_s = PATIENCE_S
    assert "Output of note:\nb\n" in env.step("<note>b</note>")[0]
    tool.go_on.set()
    env.close()
    assert (tool.opened, tool.closed) == (2, 2)


def test_a_coroutine_that_hangs_is_cancelled() -> None:
    """And its session is closed behind it."""
    tool = AsyncStuck()
    env = tool_env(tool, call_timeout_s=LIMIT_S)
    assert "The tool did not answer within 0.05 s" in asyncio.run(env.step_async("<note>wait</note>"))[0]
    assert tool.over.wait(PATIENCE_S)
    assert (tool.cancelled, tool.opened, tool.closed) == (1, 1, 1)
    env.close()


def test_a_session_that_does_not_close_in_time_holds_up_nothing(caplog: pytest.LogCaptureFixture) -> None:
    """It is said in the log."""
    tool = Stuck("close")
    env = tool_env(tool, call_timeout_s=PATIENCE_S)
    env.step("<note>a</note>")
    env._sessions.timeout_s = LIMIT_S
    env.reset(seed=2)
    assert caplog.messages == ["gem: closing the session of tool 'note' failed"]
    tool.go_on.set()
    assert tool.over.wait(PATIENCE_S)


def test_calls_that_end_in_time_are_as_without_a_limit() -> None:
    """Results, failures and sessions, for plain tools and coroutines side by side."""

    class Other(AsyncNotebook):
        name = "other"

    plain = tool_env(Calculator(), Notebook(), Other())
    limited = tool_env(Calculator(), Notebook(), Other(), call_timeout_s=PATIENCE_S)
    divide = (
        '<tool_call>{"name": "calculator", "arguments": {"left": 1, "right": 0, "operation": "divide"}}</tool_call>'
    )
    for call in ["<note>a</note>", "<note>b</note>", divide, "<note>", "<other>x</other>"]:
        assert limited.step(call) == plain.step(call)
    limited.close()


def test_a_dropped_environment_with_a_limit_closes_its_sessions() -> None:
    """As without one; a call that exits ends neither the loop nor the program."""

    class Leaving(Notebook):
        def call(self, arguments: Any, session: Any) -> Any:
            raise SystemExit(3)

    tool = Leaving()
    env = tool_env(tool, call_timeout_s=PATIENCE_S)
    assert "SystemExit: 3" in env.step("<note>a</note>")[0]
    del env
    gc.collect()
    assert tool.closed == 1


@pytest.mark.parametrize(
    "options", [{"call_timeout_s": 0}, {"call_timeout_s": float("nan")}, {"max_tool_uses": -1}, {"max_tool_uses": "2"}]
)
def test_limits_are_numbers(options: Any) -> None:
    """The error names the option."""
    with pytest.raises(ArgumentError, match=next(iter(options))):
        ToolEnv(EchoEnv(), [Notebook()], **options)


def test_the_failure_of_the_machinery_is_not_the_agents() -> None:
    """A call with a fault is told, and is a use, but no error that is paid for."""

    class Broken(Notebook):
        def call(self, arguments: Any, session: list[str]) -> gem.ToolResult:
            return gem.ToolResult("No sandbox could be started.", failed=True, info={"fault": "no memory"})

    env = tool_env(Broken(), tool_error_reward=-0.5, max_tool_uses=3)
    observation, reward, _, _, info = env.step("<note>a</note>")
    assert str(observation).startswith("Error from note:\nNo sandbox could be started.\nTool calls left: 2.")
    assert reward == 0.0
    counters = [info["tool"][key] for key in ("failed", "fault", "uses", "successes", "failures")]
    assert counters == [True, "no memory", 1, 0, 0]


class Shared(Notebook):
    """Writes into a session that all of them share, and down what happens to it."""

    def __init__(self, name: str, log: list[str]) -> None:
        super().__init__()
        self.name, self.log = name, log

    @property
    def session_key(self) -> str:
        return "shared"

    def open(self) -> list[str]:
        self.log.append(f"{self.name} opens")
        return []

    def close(self, session: Any) -> None:
        self.log.append(f"{self.name} closes")


def test_tools_with_one_key_share_a_session_that_is_opened_and_closed_once() -> None:
    """The first of them closes it; a fork has a copy."""
    log: list[str] = []
    env = tool_env(Shared("a", log), Shared("b", log), Notebook())
    env.step("<b>1</b>")
    fork = env.fork()
    assert "Output of a:\n1\n2\n" in env.step("<a>2</a>")[0]
    assert "Output of a:\n1\n3\n" in fork.step("<a>3</a>")[0]
    assert "Output of note:\nx\n" in env.step("<note>x</note>")[0]
    env.reset(seed=1)
    assert log == ["b opens", "a closes"]
    fork.close()


class ThreadNotebook(Notebook):
    """Blocks in every method, and notes in which threads."""

    concurrency = "thread"

    def __init__(self) -> None:
        super().__init__()
        self.threads: set[str] = set()

    def open(self) -> list[str]:
        self.threads.add(threading.current_thread().name)
        return super().open()

    def close(self, session: list[str]) -> None:
        self.threads.add(threading.current_thread().name)
        super().close(session)


def test_sessions_of_a_blocking_tool_never_block_the_loop() -> None:
    """Beside an asynchronous tool, it opens and closes in threads as it calls."""

    class Other(AsyncNotebook):
        name = "other"

    notebook = ThreadNotebook()
    env = tool_env(notebook, Other())
    env.step("<note>a</note>")
    env.close()
    assert (notebook.opened, notebook.closed, notebook.threads) == (1, 1, {"gem-blocking"})
