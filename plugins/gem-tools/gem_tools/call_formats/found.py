"""``ParsedCall``: a call as a reader of one format found it, and its conversion to a ``ToolCall``."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from gem_core.tools import Tool, ToolCall, unknown_tool
from gem_tools.call_formats.values import RawText, loaded, typed

Tools = Mapping[str, Tool]

NO_JSON = "is no valid JSON"

# Kimi numbers its calls, and harmony has a namespace for functions.
_DECORATED = re.compile(r"(?:functions\.)?(.*?)(?::\d+)?", re.DOTALL)

# What may close a call, and belongs to it: spare brackets, closing tags, and tokens at the end of a turn.
_CLOSINGS = re.compile(
    r"(?:\s*+(?:\]<\]minimax\[>\[</(?:invoke|tool_call)>|[\]}]|</[\w:｜]{0,40}?(?:tool_calls?|function_calls?|function|invoke|TOOLCALL)(?::\w{1,40})?>"
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
            call = ParsedCall("", None, 0, problem=f"behind {mark} stands no call")
        if call is not None and not call.cut:
            call = _with_closing(mark, text, opening.end(), call)
        return None if call is None else tool_call(call, opening.start(), tools)

    return read


def if_whole(parse: Parser) -> Parser:
    """Return a parser for which a call that cannot be read is none, as other text looks like its beginning."""

    def parse_whole(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
        call = parse(text, start, at, tools)
        return None if call is None or call.problem is not None else call

    return parse_whole


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
    arguments, error = _arguments(call.arguments, tools[name])
    if error is None and not isinstance(arguments, dict):
        error = "its arguments must be an object of names and values"
    cut = error is None and call.cut  # else closing it would not make it a call
    given = arguments if error is None else {}
    return ToolCall(name[:100], given, start, call.end, "it is never closed" if cut else error, cut=cut)


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


def closed(text: str, end: int) -> int:
    """Return the index after everything that closes a call which ends at a place."""
    found = _CLOSINGS.match(text, end)
    return found.end() if found else end


def _with_closing(mark: str, text: str, at: int, call: ParsedCall) -> ParsedCall:
    """Return a call with what closes it, or with the problem in words that name the marks."""
    closing = f"</{mark[1:]}" if _CLOSED.fullmatch(mark) else ""
    end = call.end if call.problem else closed(text, call.end)
    if call.problem is None:
        rest = text.find(closing, end) if closing and end == call.end and text[end - 1] == "}" else -1
        if rest < 0 or not text[end:rest].lstrip()[:1].isalnum():
            return call._replace(end=end)
        call = call._replace(problem=f"{NO_JSON}: Extra data behind it")
    problem = str(call.problem)
    end = text.find(closing, at) if closing else -1
    if closing and end < 0 and problem.startswith((NO_JSON, "behind")):
        return call._replace(problem=f"{mark} is never closed by {closing}")
    if problem.startswith(NO_JSON):
        where = f"between {mark} and {closing}" if closing else f"behind {mark}"
        problem = f"{where} {problem}"
    return call._replace(problem=problem, end=max(end + len(closing), call.end) if end >= 0 else call.end)


def _arguments(given: Any, tool: Tool) -> tuple[Any, str | None]:
    parameter = tool.text_parameter
    if given is None:
        return {}, None
    if isinstance(given, str):
        if given.lstrip().startswith("{"):
            read = loaded(given)
            of_the_tool = isinstance(read.value, dict) and (parameter is None or parameter in read.value)
            if of_the_tool or not (parameter and isinstance(given, RawText)):
                return read.value, f"its arguments are no valid JSON: {read.problem}" if read.problem else None
        if parameter is not None:
            return {parameter: tool.unfenced(given) if isinstance(given, RawText) else given}, None
        read = loaded(given)
        return read.value, f"its arguments are no valid JSON: {read.problem}" if read.problem else None
    if isinstance(given, dict) and any(isinstance(value, RawText) for value in given.values()):
        schema = tool.parameters_schema()
        return {name: typed(value, name, schema) for name, value in given.items()}, None
    return given, None
