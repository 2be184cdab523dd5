"""Calls as objects in JSON that name the tool, and as calls in Python."""

from __future__ import annotations

import re
from typing import Any

from gem_tools.call_formats.found import NO_JSON, ParsedCall
from gem_tools.call_formats.values import arguments_at, value_at

FORM = '{"name": "…", "arguments": {…}}'
NAMES = ("name", "tool_name", "function", "tool", "action")
ARGUMENTS = ("arguments", "parameters", "args", "input", "tool_input", "action_input")

_LIST = re.compile(r"\s*+\[\s*+(?=\{)")
_CALL = re.compile(r"\s*+(?:\[\s*+)?([A-Za-z_][\w-]{0,100}+(?:\.[A-Za-z_][\w-]{0,100}+){0,5})\s*+\(")


def json_call_at(text: str, at: int) -> ParsedCall:
    """Read the object at a place, or the first of a list of them.

    Only this one value is decoded, so that it may hold what looks like its end, and what follows may be anything.
    """
    inside = _LIST.match(text, at)
    try:
        value, end = value_at(text, inside.end() if inside else at)
    except ValueError as error:
        return ParsedCall("", None, 0, problem=f"{NO_JSON}: {error}"[:220])
    return object_call(value, end)


def object_call(value: Any, end: int) -> ParsedCall:
    """Return the call that an object describes, in the words of any family of models."""
    if isinstance(value, dict) and isinstance(value.get("function"), dict):
        value = value["function"]  # as the chat API nests it
    name = next((value[key] for key in NAMES if key in value), None) if isinstance(value, dict) else None
    if not isinstance(name, str):
        return ParsedCall("", None, end, problem=f"a call must be an object of the form {FORM}")
    return ParsedCall(name, next((value[key] for key in ARGUMENTS if key in value), None), end)


def pythonic(text: str, at: int) -> ParsedCall | None:
    """Read the call, or the first of a list of them, at a place; its arguments are literals."""
    opening = _CALL.match(text, at)
    if opening is None:
        return None
    try:
        given, end = arguments_at(text, opening.end())
    except ValueError as error:
        return ParsedCall(opening[1], None, 0, problem=f"its arguments are no literals of Python: {error}"[:220])
    return ParsedCall(opening[1], given, end)
