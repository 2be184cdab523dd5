"""``ParsedCall``: a call as a reader of one format found it, and its conversion to a ``ToolCall``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from gem_core.suggestions import did_you_mean
from gem_core.tools.calls.values import Raw, loaded, typed
from gem_core.tools.tool import Tool, ToolCall

Tools = Mapping[str, Tool]

# Kimi numbers its calls, and harmony has a namespace for functions.
_DECORATED = re.compile(r"(?:functions\.)?(.*?)(?::\d+)?", re.DOTALL)


class ParsedCall(NamedTuple):
    """A call that a reader found in a response.

    Args:
        name: Of the tool; empty where the form names none.
        arguments: An object, as a rule; or text, which is JSON or what the text parameter takes; ``Raw`` text is the
            latter. Values that are ``Raw`` are typed by the schema.
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
    arguments, error, name = resolve_arguments(name, call.arguments, tools)
    cut = error is None and call.cut  # else closing it would not make it a call
    return ToolCall(name[:100], arguments, start, call.end, "it is never closed" if cut else error, cut=cut)


def tool_taking(parameter: str, tools: Tools) -> Tool | None:
    """Return the tool for a form that names none: the first whose text parameter has this name.

    Code also goes to one that runs fenced blocks of Python.
    """
    for tool in tools.values():
        if tool.text_parameter == parameter or (
            parameter == "code" and tool.text_parameter and "python" in tool.fences
        ):
            return tool
    return None


def resolve_arguments(name: str, given: Any, tools: Tools) -> tuple[dict[str, Any], str | None, str]:
    """Return the arguments for a tool, the error in them, and the tool's name without decoration."""
    tool = tools.get(name)
    if tool is None:
        plain = _DECORATED.fullmatch(name)
        name = plain[1] if plain and plain[1] in tools else name
        tool = tools.get(name)
    if tool is None:
        return {}, unknown(name, tools), name
    arguments, problem = _arguments(given, tool)
    if problem is None and not isinstance(arguments, dict):
        problem = "its arguments must be an object of names and values"
    return ({}, problem, name) if problem else (arguments, None, name)


def unknown(name: str, tools: Tools) -> str:
    """Return the error of a call that names no tool."""
    return f"no tool {name[:100]!r}.{did_you_mean(name[:100], tools)} There are: {', '.join(tools) or 'none'}"


def _arguments(given: Any, tool: Tool) -> tuple[Any, str | None]:
    parameter = tool.text_parameter
    if given is None:
        return {}, None
    if isinstance(given, str):
        if given.lstrip().startswith("{"):
            read = loaded(given)
            of_the_tool = isinstance(read.value, dict) and (parameter is None or parameter in read.value)
            if of_the_tool or not (parameter and isinstance(given, Raw)):
                return read.value, f"its arguments are no valid JSON: {read.problem}" if read.problem else None
        if parameter is not None:
            return {parameter: tool.unfenced(given) if isinstance(given, Raw) else given}, None
        read = loaded(given)
        return read.value, f"its arguments are no valid JSON: {read.problem}" if read.problem else None
    if isinstance(given, dict) and any(isinstance(value, Raw) for value in given.values()):
        schema = tool.parameters_schema()
        return {name: typed(value, name, schema) for name, value in given.items()}, None
    return given, None
