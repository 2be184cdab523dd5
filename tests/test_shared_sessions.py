"""Tools that share a session: those of one server, of which an episode has one."""

from __future__ import annotations

from typing import Any

import gem_core as gem
from gem_core.data import DatasetEnv
from gem_core.tools.env import ToolEnv


class Counting(gem.Tool):
    """Counts the calls of its session, and writes down what happens to sessions."""

    description = "Counts."

    def __init__(self, name: str, key: str, log: list[str]) -> None:
        self.name, self._key, self._log = name, key, log

    @property
    def session_key(self) -> str:
        return self._key

    def open(self) -> dict[str, int]:
        self._log.append(f"{self.name} opens")
        return {"calls": 0}

    def close(self, session: Any) -> None:
        self._log.append(f"{self.name} closes")

    def call(self, arguments: Any, session: Any) -> str:
        session["calls"] += 1
        return str(session["calls"])


def counted(env: ToolEnv, name: str) -> str:
    """Call a tool and return its count."""
    observation = env.step(f'<tool_call>{{"name": "{name}", "arguments": {{}}}}</tool_call>')[0]
    return str(observation).splitlines()[1]


def make(log: list[str]) -> ToolEnv:
    """Return a task with two tools of one session, and one of its own."""
    tools = [Counting("a", "both", log), Counting("b", "both", log), Counting("c", "c", log)]
    env = ToolEnv(DatasetEnv([{"question": "?", "answer": "1"}]), tools, max_tool_uses=None)
    env.reset(seed=0)
    return env


def test_tools_with_one_key_share_a_session_that_is_opened_and_closed_once():
    log: list[str] = []
    env = make(log)
    assert [counted(env, name) for name in "bacab"] == ["1", "2", "1", "3", "4"]
    assert log == ["b opens", "c opens"]
    env.reset(seed=1)
    assert log == ["b opens", "c opens", "a closes", "c closes"]
    assert counted(env, "a") == "1"
    env.close()
    assert log[4:] == ["a opens", "a closes"]


def test_a_shared_session_is_forked_once_for_all():
    env = make([])
    counted(env, "a")
    other = env.fork()
    assert counted(other, "b") == "2"
    env.close()
    other.close()
