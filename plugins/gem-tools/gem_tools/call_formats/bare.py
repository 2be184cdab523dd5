"""Calls without any mark, as Llama 3, xLAM and Gemma write them: JSON, a list in Python, or one call in Python.

Such text may also be an answer, so it counts as a call only if it names a tool, begins a line, and nothing follows it.
"""

from __future__ import annotations

import re

from gem_core.tools import CALL_CLOSE, CALL_OPEN, ToolCall
from gem_tools.call_formats.found import ParsedCall, Tools, closed, tool_call
from gem_tools.call_formats.objects import ARGUMENTS, NAMES, object_call, pythonic
from gem_tools.call_formats.values import value_at

_BEFORE = re.compile(r"\s*+(?:```\w*+\s*+)?(?:\[\s*+)?")
_BEHIND = re.compile(r"(?:\s|[,;\]]|```)*")
_NAMED = re.compile(r"[\w-]{1,100}+\(")


def read_json(opening: re.Match[str], tools: Tools) -> ToolCall | None:
    """Read an object that describes a call; with an ``error`` if it stands within a sentence."""
    text, start = opening.string, opening.start()
    try:
        value, end = value_at(text, start)
    except ValueError:
        value, end = None, len(text)
    call = object_call(value, end) if value is not None else _broken(text, start, tools)
    if call is None or (call.problem and value is not None) or not _is_call(value, call, tools):
        return None
    if call.problem is None and not (_begins_line(text, start) and _nothing_behind(text, end)):
        call = call._replace(problem=f"a call in JSON must stand between {CALL_OPEN} and {CALL_CLOSE}")
    return tool_call(call if call.problem else call._replace(end=closed(text, end)), start, tools)


def read_python_list(opening: re.Match[str], tools: Tools) -> ToolCall | None:
    """Read a list of calls in Python that begins a line."""
    text, start = opening.string, opening.start()
    call = pythonic(text, start) if _begins_line(text, start) else None
    if call is None or call.name not in tools or (call.problem is None and not _nothing_behind(text, call.end)):
        return None
    return tool_call(call._replace(end=closed(text, call.end)), start, tools)


def read_python(opening: re.Match[str], tools: Tools) -> ToolCall | None:
    """Read a response that is one call in Python."""
    text = opening.string
    call = pythonic(text, opening.end())
    if call is None or call.problem is not None or call.name not in tools or text[call.end :].strip():
        return None
    return tool_call(call, opening.end(), tools)


def _is_call(value: object, call: ParsedCall, tools: Tools) -> bool:
    if value is None:
        return True  # broken, and of a tool
    inner = value.get("function") if isinstance(value, dict) else None
    described = inner if isinstance(inner, dict) else value
    if not isinstance(value, dict) or not isinstance(described, dict):
        return False
    given = any(key in described for key in ARGUMENTS)
    return (given and call.name in tools) or (given and value.get("type") == "function")


def _broken(text: str, start: int, tools: Tools) -> ParsedCall | None:
    """Return the problem of JSON that cannot be read and begins as a call of a tool."""
    names = "|".join(map(re.escape, tools))
    keys, given = "|".join(NAMES), "|".join(ARGUMENTS)
    known = re.compile(
        rf"""\{{\s*+(?:["']type["']\s*+:\s*+["']function["']\s*+,\s*+)?["'](?:{keys})["']\s*+:\s*+["'](?:{names})["']\s*+,"""
        rf"""\s*+["'](?:{given})["']"""
    )
    if not tools or known.match(text, start) is None:
        return None
    return ParsedCall("", None, len(text), problem="the call is no valid JSON, or is not complete")


def _begins_line(text: str, start: int) -> bool:
    before = text[text.rfind("\n", 0, start) + 1 : start]
    return _BEFORE.fullmatch(before) is not None


def _nothing_behind(text: str, end: int) -> bool:
    """Tell whether nothing follows, or another call."""
    end = closed(text, end)
    found = _BEHIND.match(text, end)
    end = closed(text, found.end() if found else end)
    return end >= len(text) or text[end] in "{[<" or _NAMED.match(text, end) is not None
