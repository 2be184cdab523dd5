"""Tools: how calls are read, what is answered, and what never happens."""

from __future__ import annotations

import asyncio
import gc
import json
import threading
from typing import Any

import pydantic
import pytest
from toys import AsyncNotebook, Calculator, CountdownEnv, EchoEnv, Notebook

import gem_core as gem
from gem_core.background import run_sync
from gem_core.env.guard import Guard
from gem_core.errors import ArgumentError, ResetNeededError, UnknownToolError
from gem_core.testing.hostile import hostile_actions
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
    "call", ["<note>a line</note>", "\n   ```note\n   a line\n   ```\n", json_call("note", line="a line")]
)
def test_the_three_text_forms_mean_the_same(call: str) -> None:
    """A tag, a fenced block and a JSON call are one call."""
    info = tool_env().step(f"I write: {call} and so on")[4]
    assert info["tool"]["arguments"] == {"line": "a line"}
    assert info["tool"]["lines"] == 1


def test_the_first_complete_call_is_executed_and_the_rest_is_not_read() -> None:
    """A tag that is never closed does not hide a whole call behind it."""
    info = tool_env().step("first <note>a</note> then <note>b</note> \\boxed{7}")[4]
    assert info["parsed_action"] == "first <note>a</note>"
    assert info["tool"]["uses"] == 1
    info = tool_env().step(f"<note> {json_call('calculator', left=1, right=1)}")[4]
    assert info["tool"]["name"] == "calculator"


def test_a_response_without_a_call_goes_to_the_task() -> None:
    """The task gets it to the letter."""
    observation, reward, *_ = tool_env().step("25")
    assert observation == "You said '25'.\nLeft: 8."
    assert reward == 1.0


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ("<note>", "The call could not be read: <note> is never closed by </note>"),
        ("```note\n", "The call could not be read: the fenced block is never closed"),
        ("<tool_call>{", "The call could not be read: <tool_call> is never closed by </tool_call>"),
        ("<tool_call>{]</tool_call>", "is no valid JSON"),
        ("<tool_call>[]</tool_call>", "a call must be an object of the form"),
        (json_call("calculater"), "no tool 'calculater'. Did you mean 'calculator'? There are: calculator, note"),
        ('<tool_call>{"name": "note", "arguments": 3}</tool_call>', "its arguments must be an object"),
        ("<tool_call>" + "[" * 100_000 + "</tool_call>", "is no valid JSON: it is nested too deeply"),
        (f'<tool_call>{{"x": {"[" * 200}{"]" * 200}}}</tool_call>', "is no valid JSON: it is nested too deeply"),
        ('<tool_call>{"name": "note", "x": NaN}</tool_call>', "is no valid JSON: NaN is no finite number"),
        ('<tool_call>{"name": "note", "x": 1e999}</tool_call>', "is no valid JSON: 1e999 is no finite number"),
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


def test_native_calls_beyond_the_limit_are_answered_with_an_error() -> None:
    """Every call gets its answer, and the one that was not executed is not counted."""
    env = tool_env(max_tool_uses=1)
    calls = [native("note", '{"line": "a"}', "c1"), native("note", '{"line": "b"}', "c2")]
    info = env.step(gem.Response("", tool_calls=calls))[4]
    assert info["messages"][1]["content"] == (
        "Error from note:\nNo tool calls were left: this one was not executed.\n"
        "No tool calls are left. Give your answer to the task now."
    )
    assert info["tool"]["uses"] == 1
    assert env.step(gem.Response("7", tool_calls=calls))[0] == "You said '7'.\nLeft: 8."


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


def test_custom_tools_of_the_api_take_plain_text() -> None:
    """Which goes to the one text parameter."""
    call = {"id": "c1", "type": "custom", "custom": {"name": "note", "input": "a line"}}
    assert tool_env().step(gem.Response("", tool_calls=[call]))[4]["tool"]["lines"] == 1


def test_rewards_of_tool_steps() -> None:
    """A readable call, its success and its failure are paid apart."""
    env = tool_env(tool_reward=0.05, tool_success_reward=0.25, tool_error_reward=-0.5)
    calls = ["<note>a</note>", json_call("calculator", left=1, right=0, operation="divide"), "<note>"]
    assert [env.step(call)[1] for call in calls] == pytest.approx([0.3, -0.45, -0.5])


def test_when_the_uses_are_spent_the_next_response_goes_to_the_task() -> None:
    """The last tool observation says so."""
    env = tool_env(max_tool_uses=2)
    env.step("<note>")
    assert "No tool calls are left. Give your answer to the task now." in str(env.step("<note>a</note>")[0])
    assert env.step("<note>a</note>")[0] == "You said '<note>a</note>'.\nLeft: 8."


def test_first_observation_explains_the_tools_and_info_has_their_schemas() -> None:
    """An agent learns how to call, and a server gets schemas."""
    env = ToolEnv(CountdownEnv(), [Calculator(), Notebook()])
    observation, info = env.reset(seed=1, options={"left": 2})
    assert observation == info["feedback"] + info["suffix"]
    assert [tool["function"]["name"] for tool in info["tools"]] == ["calculator", "note"]
    assert info["tools"][1]["function"]["parameters"]["required"] == ["line"]
    assert ToolEnv(EchoEnv(), [Notebook()], instructions=False).reset()[0] == "Say something."


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


def test_asynchronous_tools_work_in_plain_code_and_in_coroutines() -> None:
    """Written once, run anywhere, with the same results."""
    plain, other = tool_env(AsyncNotebook()), tool_env(AsyncNotebook())
    assert plain.concurrency == "async"
    assert plain.step("<note>a</note>") == asyncio.run(other.step_async("<note>a</note>"))
    plain.close()
    other.close()


@pytest.mark.parametrize("uses", [-1, 1.5, "2"])
def test_a_limit_of_uses_is_a_whole_number(uses: Any) -> None:
    with pytest.raises(ArgumentError, match="max_tool_uses"):
        ToolEnv(EchoEnv(), [Notebook()], max_tool_uses=uses)


def test_tools_by_name_need_a_registered_tool() -> None:
    """The error says what there is, and what to install."""
    with pytest.raises(UnknownToolError, match="no tool 'calculatr'"):
        ToolEnv(EchoEnv(), ["calculatr"])


@pytest.mark.parametrize("action", hostile_actions(), ids=lambda action: repr(action[:12]))
def test_hostile_responses_never_raise(action: str) -> None:
    """Whatever a model writes is answered."""
    env = tool_env(max_tool_uses=None)
    observation, reward, *_ = env.step(action)
    assert isinstance(observation, str)
    assert reward == reward


def test_schema_is_the_openai_form() -> None:
    """As a chat server wants it."""
    schema = Calculator().schema()
    assert schema["type"] == "function"
    assert set(schema["function"]) == {"name", "description", "parameters"}
    assert schema["function"]["parameters"]["properties"]["operation"]["default"] == "add"


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


def test_a_tool_whose_session_cannot_be_opened_is_an_observation() -> None:
    """The session is tried again at the next call."""

    class Locked(Notebook):
        def open(self) -> list[str]:
            if super().open() == [] and self.opened == 1:
                raise OSError("locked")
            return []

    env = tool_env(Locked())
    assert "The tool failed: OSError: locked" in str(env.step("<note>a</note>")[0])
    assert "Output of note" in str(env.step("<note>a</note>")[0])


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


def test_only_the_session_may_be_asynchronous() -> None:
    """A tool whose open() and close() alone are coroutine functions runs them on the loop."""

    class Slow(Notebook):
        async def open(self) -> list[str]:  # type: ignore[override]  # a coroutine is allowed in its place
            await asyncio.sleep(0)
            return super().open()

        async def close(self, session: list[str]) -> None:  # type: ignore[override]  # as above
            await asyncio.sleep(0)
            super().close(session)

    notebook = Slow()
    env = tool_env(notebook)
    assert "Output of note:\na" in str(env.step("<note>a</note>")[0])
    env.close()
    assert (notebook.opened, notebook.closed) == (1, 1)


def test_sessions_are_closed_on_the_library_loop_too() -> None:
    """Where close() cannot wait, as when the garbage collector runs there, closing is started at once."""
    notebook = AsyncNotebook()
    env = tool_env(notebook)
    env.step("<note>a</note>")

    async def close() -> None:
        env.close()
        await asyncio.sleep(0)

    run_sync(close())
    assert notebook.closed == 1
