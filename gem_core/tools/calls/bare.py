"""Calls without any mark, as Llama 3, xLAM and Gemma write them: JSON, a list in Python, or a name on its own line.

Such text may also be an answer, so it counts as a call only if it names a tool, begins a line, and nothing follows it.
"""

from __future__ import annotations

import re
from itertools import islice

from gem_core.tools.calls.found import ParsedCall, Tools, tool_call
from gem_core.tools.calls.json_calls import ARGUMENTS, NAMES, object_call
from gem_core.tools.calls.marked import functionary_v3
from gem_core.tools.calls.pythonic import pythonic
from gem_core.tools.calls.table import closed
from gem_core.tools.calls.values import value_at
from gem_core.tools.tool import CALL_CLOSE, CALL_OPEN, ToolCall

_KEYS = "|".join((*NAMES, *ARGUMENTS, "type", "id", "tool_call_id"))
_OBJECT = re.compile(rf"""\{{\s*+["'](?:{_KEYS})["']\s*+:""")
_BEFORE = re.compile(r"\s*+(?:```\w*+\s*+)?(?:\[\s*+)?")
_BEHIND = re.compile(r"(?:\s|[,;\]]|```)*")
_PYTHONIC = re.compile(r"^[ \t]*+\[\s*+[A-Za-z_]", re.MULTILINE)
_MOST_OBJECTS = 20


def bare_call(text: str, tools: Tools) -> ToolCall | None:
    """Return the call of a response that has no mark; with an ``error`` if it stands within a sentence."""
    if not any(name in text for name in tools) and '"function"' not in text:
        return None
    return _json(text, tools) or _pythonic(text, tools) or _headed(text, tools)


def _json(text: str, tools: Tools) -> ToolCall | None:
    for found in islice(_OBJECT.finditer(text), _MOST_OBJECTS):
        start = found.start()
        try:
            value, end = value_at(text, start)
        except ValueError:
            value, end = None, len(text)
        call = object_call(value, end) if value is not None else _broken(text, start, tools)
        if call is None or (call.problem and value is not None) or not _is_call(value, call, tools):
            continue
        alone = _begins_line(text, start) and _nothing_behind(text, end)
        if not alone and call.problem is None:
            call = call._replace(problem=f"a call in JSON must stand between {CALL_OPEN} and {CALL_CLOSE}")
        return tool_call(call if call.problem else call._replace(end=closed(text, end)), start, tools)
    return None


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


def _pythonic(text: str, tools: Tools) -> ToolCall | None:
    for found in islice(_PYTHONIC.finditer(text), _MOST_OBJECTS):
        call = pythonic(text, found.start())
        if call is not None and call.name in tools:
            if call.problem is None and not _nothing_behind(text, call.end):
                continue
            return tool_call(call._replace(end=closed(text, call.end)), found.start(), tools)
    return None


def _headed(text: str, tools: Tools) -> ToolCall | None:
    """Read a response that is a call of Functionary v3, whose prompt ends in the mark, or one call in Python."""
    start = len(text) - len(text.lstrip())
    call = pythonic(text, start)
    if call is not None and call.problem is None and call.name in tools and not text[call.end :].strip():
        return tool_call(call, start, tools)
    call = functionary_v3(text, start, start, tools)
    if call is None or isinstance(call.arguments, str):
        return None
    return tool_call(call, start, tools)


def _begins_line(text: str, start: int) -> bool:
    before = text[text.rfind("\n", 0, start) + 1 : start]
    return _BEFORE.fullmatch(before) is not None


def _nothing_behind(text: str, end: int) -> bool:
    """Tell whether nothing follows, or another call."""
    end = closed(text, end)
    found = _BEHIND.match(text, end)
    end = closed(text, found.end() if found else end)
    return end >= len(text) or text[end] in "{[<" or re.compile(r"[\w-]{1,100}+\(").match(text, end) is not None
