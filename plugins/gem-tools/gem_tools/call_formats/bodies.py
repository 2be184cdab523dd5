"""Calls behind a mark that says only that a call follows; what follows is the same in many families."""

from __future__ import annotations

import re

from gem_tools.call_formats.found import ParsedCall, Tools, if_whole, reads
from gem_tools.call_formats.objects import json_call_at, pythonic
from gem_tools.call_formats.tagged import elements, function, keyed
from gem_tools.call_formats.values import value_at

_MARKS = re.compile(
    r"(?:\s|<\|tool_calls?_section_begin\|>|<\|tool_call_begin\|>|<｜tool▁calls?▁begin｜>|<｜tool_calls?_begin｜>"
    r"|function<｜tool_sep｜>|<\|plugin\|>|<(?:longcat_)?tool_call(?::\w+)?>|<invoke>|\[TOOL_CALLS\]|```(?:json)?(?=\s*+[\[{]))*"
)
_NAMED = re.compile(
    r"(?:call:|function<｜tool▁sep｜>(?=\w))?([\w.:/-]{1,200}+)(?:\[CALL_ID\][\w-]{1,100}+)?\s*+"
    r"(?:\[ARGS\]|<｜tool▁sep｜>|<\|tool_call_argument_begin\|>|<tool_sep(?::\w+)?>)?(?:\s|\\n)*(```(?:json)?\s*+)?"
)
_FENCE_END = re.compile(r"\s*+```")


def body(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Read a call after a mark that many families use; the next character decides which form it is."""
    marks = _MARKS.match(text, at)
    at = marks.end() if marks else at
    first = text[at : at + 1]
    if first == "<":
        return elements(text, at) or function(text, at, at, tools) or json_call_at(text, at)
    if first == "[":
        call = pythonic(text, at)
        if call is not None:
            return call
    if first not in ("", "[", "{", '"'):
        return _named(text, at) or json_call_at(text, at)
    return json_call_at(text, at)


def _named(text: str, at: int) -> ParsedCall | None:
    """Read a call that begins with the tool's name, as Mistral, DeepSeek, Kimi, GLM, Gemma and OLMo write it."""
    opening = _NAMED.match(text, at)
    if opening is None:
        return None
    name, at = opening[1], opening.end()
    if text.startswith("{", at):
        try:
            given, end = value_at(text, at)
        except ValueError as error:
            return ParsedCall(name, None, 0, problem=f"its arguments are no valid JSON: {error}"[:250])
        fence = _FENCE_END.match(text, end) if opening[2] else None
        return ParsedCall(name, given, fence.end() if fence else end)
    if text.startswith("(", at):
        return pythonic(text, opening.start(1))
    if text.startswith("</tool_call", at):
        return ParsedCall(name, {}, at)
    return keyed(name, text, at)


def element(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Read an element that names the tool, or what stands behind a mark that may be missing around it."""
    return function(text, start, at, tools) or body(text, start, at, tools)


def tool_keys(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Apertus: a list of objects, each with the tool's name as its only key."""
    call = json_call_at(text, at)
    if call.problem is None or not call.end:
        return call
    try:
        value, end = value_at(text, text.index("{", at))
    except ValueError:
        return call
    if not isinstance(value, dict) or len(value) != 1:
        return call
    name, given = next(iter(value.items()))
    return ParsedCall(str(name), given, end)


def unmarked(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Gemma 4 without its marks, where the server leaves them out: ``call:NAME{…}`` of a tool."""
    call = _named(text, start) if text[start - 1 : start] in ("", "\n") else None
    return call if call is not None and call.name in tools else None


read_body = reads(body)
read_whole_body = reads(if_whole(body), sure=False)
read_element = reads(element)
read_tool_keys = reads(tool_keys)
read_unmarked = reads(unmarked, sure=False)
