"""What a tool may be: one or several under a name, with a pydantic model or with a JSON Schema alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from toys import EchoEnv, Notebook

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_core.testing import check_tool
from gem_core.tools.env import ToolEnv


def json_call(name: str, **arguments: Any) -> str:
    return f"<tool_call>{json.dumps({'name': name, 'arguments': arguments})}</tool_call>"


def test_two_tools_of_one_name_are_refused(toolbox: Path) -> None:
    """Calls could not be told apart."""
    with pytest.raises(ArgumentError, match="one name, 'note'"):
        ToolEnv(EchoEnv(), [Notebook(), Notebook()])
    with pytest.raises(ArgumentError, match="one name, 'look'"):
        ToolEnv(EchoEnv(), ["box", "box"])
    renamed = ToolEnv(EchoEnv(), ["box", ("box", {"prefix": "my_"})])
    assert list(renamed.tools) == ["look", "count", "my_look", "my_count"]


def test_a_name_may_stand_for_several_tools(toolbox: Path) -> None:
    """As that of a server does; each is a tool like any other."""
    env = gem.make("toy:Countdown-v0", wrappers=["box", "vault"])
    assert list(env.tools) == ["look", "count", "vault"]
    observation, info = env.reset(seed=1)
    assert "- look: Looks at a lock. Call it with <look>lock</look>\n" in observation
    assert '- count: Counts the locks. Call it with <tool_call>{"name": "count", "arguments": {}}</tool_call>' in (
        observation
    )
    assert [tool["function"]["name"] for tool in info["tools"]] == ["look", "count", "vault"]
    assert env.step("<look>north</look>")[0].startswith("Output of look:\nbrass\n")
    assert env.step(json_call("count"))[0].startswith("Output of count:\n2\n")
    assert env.spec.make().tools.keys() == env.tools.keys()


def test_what_is_no_tool_is_refused(offer: Callable[..., None]) -> None:
    """Whether alone or in a list."""
    offer(gem.ToolSpec(name="mixed", entry_point=lambda: [Notebook(), 3]))
    with pytest.raises(ArgumentError, match="the entry point of tool 'mixed' returned int, not a Tool"):
        ToolEnv(EchoEnv(), ["mixed"])
    with pytest.raises(ArgumentError, match="a tool is a Tool, a name, or"):
        ToolEnv(EchoEnv(), [3])  # type: ignore[list-item]  # the point


def test_a_tool_may_validate_by_itself(toolbox: Path) -> None:
    """Without a pydantic model; its words reach the agent."""
    env = ToolEnv(EchoEnv(), ["box"])
    env.reset()
    assert "Error from look:\nThe arguments are not valid. lock is missing\n" in env.step(json_call("look"))[0]
    assert env.tools["count"].parse("<count>1</count>") is None


@pytest.mark.parametrize(
    ("schema", "parameter"),
    [
        ({"type": "object"}, None),
        ({"type": "object", "properties": {"a": {"type": "string"}}}, "a"),
        ({"properties": {"a": {"type": "string"}, "b": {"type": "string"}}, "required": ["b"]}, "b"),
        ({"properties": {"a": {"type": "string"}, "b": {"type": "string"}}}, None),
        ({"properties": {"a": {"type": "string", "enum": ["x"]}}}, None),
        ({"properties": {"a": True}, "required": ["a"]}, None),
        ({"properties": []}, None),
        ({"properties": {"a": {"type": "string"}}, "required": [["a"]]}, None),
    ],
)
def test_the_text_parameter_is_read_off_the_schema(schema: dict[str, Any], parameter: str | None) -> None:
    """The one that is required, or the only one, if any text will do; a schema may be somebody else's, and odd."""

    class Bare(gem.Tool):
        name = "bare"

        def parameters_schema(self) -> dict[str, Any]:
            return schema

    assert Bare().text_parameter == parameter
    assert "Call it with" in Bare().instructions()


@pytest.mark.thorough
def test_each_of_several_tools_is_checked(toolbox: Path) -> None:
    """By its name, or all."""
    assert "A call succeeds." in check_tool("box", {"lock": "north"}, name="look")
    assert check_tool("box").count("It has a description.") == 2
    with pytest.raises(ArgumentError, match="name one of these tools: look, count; not None"):
        check_tool("box", {"lock": "north"})
    with pytest.raises(ArgumentError, match="name one of these tools: look, count; not 'lok'"):
        check_tool("box", name="lok")
