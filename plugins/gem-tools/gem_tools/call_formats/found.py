"""``ParsedCall``: a call as a reader of one format found it, and its conversion to a ``ToolCall``."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from gem_core.tools import Tool, ToolCall, unknown_tool
from gem_tools.call_formats.values import RawText, loaded, typed

Tools = Mapping[str, Tool]

# Kimi numbers its calls, and harmony has a namespace for functions.
_DECORATED = re.compile(r"(?:functions\.)?(.*?)(?::\d+)?", re.DOTALL)

# What may close a call, and belongs to it: spare brackets, closing tags, and tokens at the end of a turn.
_CLOSINGS = re.compile(
    r"(?:\s*+(?:[\]}]|</[\w:｜]{0,40}?(?:tool_calls?|function_calls?|function|invoke|TOOLCALL)(?::\w{1,40})?>"
    r"|<[|｜][\w▁]{0,40}?(?:end|END|suffix)[\w▁]{0,40}[|｜]>"
    r"|<\|(?:call|eot|eot_id|eom_id|stop)\|>|<end_function_call>|<tool_call\|>|</s>))*"
)

_CLOSED = re.compile(r"<(?:\w+:)?(?:tool_calls?|function_calls|invoke|TOOLCALL|longcat_tool_call)(?::\w+)?>")


class ParsedCall(NamedTuple):
    """A call that a reader found in a response.

    Args:
        name: Name of the tool; empty if the form names none.
        arguments: An object, as a rule; or text: ``RawText`` for the text parameter, else JSON. Values that are
            ``RawText`` are typed by the schema.
        end: Index of the first character after the call.
        takes: In place of a name, the parameter that is given, as ``"code"``.
        problem: Why it cannot be read.
        cut: Whether the text ends before the call is closed.
    """

    name: str
    arguments: Any
    end: int
    takes: str = ""
    problem: str | None = None
    cut: bool = False


Parser = Callable[[str, int, int, Tools], ParsedCall | None]
"""Reads a call, given the response, where the opening mark begins and ends, and the tools; None where there is none."""

Reader = Callable[[re.Match[str], Tools], ToolCall | None]
"""What ``CallFormatSpec`` names."""


def reads(parse: Parser, *, sure: bool = True) -> Reader:
    """Return a reader for the hook.

    Args:
        parse: Reads the call behind a mark.
        sure: Whether the mark stands for a call and nothing else, so that one without a call is told.
    """

    def read(opening: re.Match[str], tools: Tools) -> ToolCall | None:
        text, mark = opening.string, opening[0]
        call = parse(text, opening.start(), opening.end(), tools)
        if call is None and sure:
            call = ParsedCall("", None, 0, problem="stands no call")
        if call is None:
            return None
        closing = f"</{mark[1:]}" if _CLOSED.fullmatch(mark) else ""
        place = text.find(closing, max(call.end, opening.end())) if closing else -1
        if call.problem is None and not call.cut:
            end = closed(text, call.end)
            if place >= 0 and text[end - 1] == "}" and text[end:place].lstrip()[:1].isalnum():
                call = call._replace(problem="is no valid JSON: Extra data behind it")
            else:
                call = call._replace(end=end)
        if call.problem is not None:
            end = place + len(closing) if place >= 0 else call.end
            call = call._replace(problem=f"behind {mark} {call.problem}", end=end)
        return tool_call(call, opening.start(), tools)

    return read


def tool_call(call: ParsedCall, start: int, tools: Tools) -> ToolCall:
    """Return the call of a tool, with an error where there is no such tool or its arguments cannot be read."""
    name = call.name
    if call.problem is not None:
        return ToolCall(name[:100], {}, start, call.end, call.problem)
    if call.takes:
        tool = tool_taking(call.takes, tools)
        if tool is None:
            there_are = ", ".join(tools) or "none"
            return ToolCall("", {}, start, call.end, f"no tool takes {call.takes} alone. There are: {there_are}")
        name = tool.name
    if name not in tools:
        plain = _DECORATED.fullmatch(name)
        name = plain[1] if plain and plain[1] in tools else name
    if name not in tools:
        return ToolCall(name[:100], {}, start, call.end, unknown_tool(name, tools))
    try:
        arguments = _arguments(call.arguments, tools[name])
    except ValueError as error:
        return ToolCall(name, {}, start, call.end, f"its arguments are no valid JSON: {error}"[:250])
    if not isinstance(arguments, dict):
        return ToolCall(name, {}, start, call.end, "its arguments must be an object of names and values")
    return ToolCall(name, arguments, start, call.end, "it is never closed" if call.cut else None, cut=call.cut)


def tool_taking(parameter: str, tools: Tools) -> Tool | None:
    """Return the tool for a form that names none: the first whose text parameter has this name.

    Code also goes to one that runs fenced blocks of Python.
    """
    for tool in tools.values():
        runs_python = parameter == "code" and tool.text_parameter and "python" in tool.fences
        if tool.text_parameter == parameter or runs_python:
            return tool
    return None


def closed(text: str, end: int) -> int:
    """Return the index after everything that closes a call which ends at a place."""
    found = _CLOSINGS.match(text, end)
    return found.end() if found else end


def _arguments(given: Any, tool: Tool) -> Any:
    parameter = tool.text_parameter
    if given is None:
        return {}
    if isinstance(given, dict):
        schema = tool.parameters_schema() if any(isinstance(value, RawText) for value in given.values()) else {}
        return {name: typed(value, name, schema) for name, value in given.items()}
    if not isinstance(given, str):
        return given
    if parameter is not None and isinstance(given, RawText):
        try:
            value = loaded(given)
        except ValueError:
            value = None
        return value if isinstance(value, dict) and parameter in value else {parameter: tool.unfenced(given)}
    return {parameter: given} if parameter is not None and not given.lstrip().startswith("{") else loaded(given)
