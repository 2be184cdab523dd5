"""Tools: how calls are read, what is answered, and what never happens."""

from __future__ import annotations

import gc
import json
from typing import Any

import pydantic
import pytest
from toys import Calculator, CountdownEnv, EchoEnv, Notebook

import gem_core as gem
from gem_core.env.guard import Guard
from gem_core.errors import ResetNeededError
from gem_core.tools.env import ToolEnv

TOOLS = (Calculator, Notebook)


def tool_env(*tools: gem.Tool, **options: Any) -> ToolEnv:
    env = ToolEnv(Guard(CountdownEnv()), list(tools) or [Calculator(), Notebook()], **options)
    env.reset(seed=1, options={"left": 9})
    return env


def json_call(name: str, **arguments: Any) -> str:
    return f"<tool_call>{json.dumps({'name': name, 'arguments': arguments})}</tool_call>"


def test_json_call_is_executed() -> None:
    """The result comes back, with how things stand in the task, and the task does not move."""
    env = tool_env()
    observation, reward, terminated, truncated, info = env.step(json_call("calculator", left=2, right=3))
    assert observation == (
        "Output of calculator:\n5.0\nTool calls left: 4. Call a tool again, or give your answer.\nLeft: 9."
    )
    assert (reward, terminated, truncated) == (0.0, False, False)
    call = {"name": "calculator", "arguments": {"left": 2, "right": 3}, "failed": False, "error": None}
    assert info["tool"] == {
        **call,
        "calls": [call],
        "uses": 1,
        "successes": 1,
        "failures": 0,
    }
    assert observation == info["feedback"] + info["suffix"]


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ("<note>", "The call could not be read: <note> is never closed by </note>"),
        (json_call("calculator", left=1), "The arguments are not valid. right: Field required"),
        (json_call("calculator", left="x", right=1), "left: Input should be a valid number"),
        (json_call("calculator", left=1, right=0, operation="divide"), "The tool failed: ZeroDivisionError"),
    ],
)
def test_a_call_that_cannot_be_read_or_fails_is_told_to_the_agent(action: str, message: str) -> None:
    """It counts as a use, says what is wrong, and never reaches the task."""
    env = tool_env(tool_error_reward=-0.25)
    observation, reward, terminated, truncated, info = env.step(action)
    assert message in str(observation)
    assert (reward, terminated, truncated) == (-0.25, False, False)
    assert (info["tool"]["uses"], info["tool"]["failures"], info["tool"]["failed"]) == (1, 1, True)
    assert "Left: 9." in str(observation)


def native(name: str, arguments: object, call_id: str = "c1") -> dict[str, Any]:
    return {"id": call_id, "type": "function", "function": {"name": name, "arguments": arguments}}


def test_native_calls_are_all_executed_in_order() -> None:
    """And win over calls in the text, which is then only text."""
    env = tool_env(tool_reward=0.5, tool_success_reward=1.0, tool_error_reward=-2.0)
    calls = [native("note", '{"line": "a"}', "c1"), native("nte", "{}", "c2"), native("note", {"line": "b"}, "c3")]
    observation, reward, _, _, info = env.step(gem.Response("<note>text</note>", tool_calls=calls))
    assert str(observation).startswith("Output of note:\na\nError from nte:\n")
    assert [m["tool_call_id"] for m in info["messages"]] == ["c1", "c2", "c3"]
    assert [call["failed"] for call in info["tool"]["calls"]] == [False, True, False]
    assert (info["tool"]["uses"], info["tool"]["successes"], info["tool"]["failures"]) == (3, 2, 1)
    assert reward == 0.5 * 2 + 1.0 * 2 - 2.0
    assert info["parsed_action"] == "<note>text</note>"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (native("note", "{"), "its arguments are no valid JSON"),
        (native("note", "[1]"), "its arguments must be an object of names and values"),
        (native("note", "[" * 100_000), "its arguments are no valid JSON: it is nested too deeply"),
        (native("nte", "{}"), "no tool 'nte'. Did you mean 'note'? There are: calculator, note"),
        (native("note", None), "The arguments are not valid. line: Field required"),
        ({"id": "c1"}, "a native call must name a function"),
        ({"function": {"name": 3}}, "a native call must name a function"),
    ],
)
def test_native_calls_that_cannot_be_read_are_answered(call: Any, message: str) -> None:
    """Whatever the server passes on."""
    info = tool_env().step(gem.Response("", tool_calls=[call]))[4]
    assert message in info["messages"][0]["content"]
    assert info["tool"]["failed"] is True


def test_when_the_uses_are_spent_the_next_response_goes_to_the_task() -> None:
    """The last tool observation says so."""
    env = tool_env(max_tool_uses=2)
    env.step("<note>")
    assert "No tool calls are left. Give your answer to the task now." in str(env.step("<note>a</note>")[0])
    assert env.step("<note>a</note>")[0] == "You said '<note>a</note>'.\nLeft: 8."
    env = tool_env(max_tool_uses=1)
    calls = [native("note", '{"line": "a"}', "c1"), native("note", '{"line": "b"}', "c2")]
    info = env.step(gem.Response("", tool_calls=calls))[4]
    assert "this one was not executed" in info["messages"][1]["content"]
    assert info["tool"]["uses"] == 1


def test_fences_that_are_answers_are_left_to_the_task() -> None:
    """A task that answers in fenced blocks keeps them, and tags still work."""

    class TextTool(Notebook):
        fences = ("text",)

    tool = TextTool()
    env = ToolEnv(EchoEnv(), [tool])
    explained = str(env.reset()[0])
    assert "<note>" in explained
    assert "fenced block" not in explained
    assert "a fenced block marked text" in tool.instructions()
    assert env.step("```text\nmine\n```")[0] == "Heard: ```text\nmine\n```"
    assert "Output of note" in str(env.step("<note>x</note>")[0])


def test_sessions_are_opened_lazily_and_closed_at_reset_and_close() -> None:
    """A session belongs to one episode; a forgotten environment leaves none open."""
    notebook = Notebook()
    env = tool_env(notebook)
    assert notebook.opened == 0
    env.step("<note>a</note>")
    assert "a\nb" in str(env.step("<note>b</note>")[0])
    env.reset(seed=2)
    assert (notebook.opened, notebook.closed) == (1, 1)
    env.step("<note>c</note>")
    env.close()
    env.close()
    assert (notebook.opened, notebook.closed) == (2, 2)
    env.reset(seed=3)
    env.step("<note>d</note>")
    del env
    gc.collect()
    assert (notebook.opened, notebook.closed) == (3, 3)


def test_tools_are_refused_outside_an_episode() -> None:
    """Before the first reset and after the end, as every other step is; a fork knows it too."""
    notebook = Notebook()
    env = ToolEnv(CountdownEnv(), [notebook])
    for _ in range(2):
        with pytest.raises(ResetNeededError, match="CountdownEnv"):
            env.step("<note>a</note>")
        env.reset(seed=1, options={"left": 1})
        env.step("the answer")
    with pytest.raises(ResetNeededError):
        env.fork().step("<note>a</note>")
    assert notebook.opened == 0


class Failing(Calculator):
    """Fails in a way of its own."""

    class Parameters(Calculator.Parameters):
        """A validator that fails otherwise than pydantic expects."""

        @pydantic.field_validator("operation")
        @classmethod
        def check(cls, value: str) -> str:
            return value if value in ("add", "exit", "number", "parts") else {"a": value}["b"]

    def call(self, arguments: Any, session: Any) -> Any:
        if arguments.operation == "exit":
            raise SystemExit(1)
        return gem.ToolResult(3 if arguments.operation == "number" else ["part"])  # type: ignore[arg-type]  # the point


@pytest.mark.parametrize(
    ("operation", "message"),
    [
        ("exit", "The tool failed: SystemExit: 1"),
        ("number", "The tool failed: TypeError: calculator returned int, not text"),
        ("parts", "The tool failed: TypeError: calculator returned list, not text"),
        ("other", "The arguments are not valid. KeyError: 'b'"),
    ],
)
def test_a_tool_that_fails_in_odd_ways_is_an_observation(operation: str, message: str) -> None:
    """An exit, content that is none, a validator that raises what it likes."""
    env = tool_env(Failing())
    assert message in str(env.step(json_call("calculator", left=1, right=1, operation=operation))[0])
