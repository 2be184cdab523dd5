"""Calls that are JSON: an object, or a list of them, that names the tool."""

from __future__ import annotations

import re
from typing import Any

from gem_core.tools.calls.found import ParsedCall
from gem_core.tools.calls.values import skip_blanks, value_at

FORM = '{"name": "…", "arguments": {…}}'
NO_JSON = "is no valid JSON"
NAMES = ("name", "tool_name", "function", "tool", "action")
ARGUMENTS = ("arguments", "parameters", "args", "input", "tool_input", "action_input")

_LIST = re.compile(r"\s*+\[\s*+(?=\{)")


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


def fenced_list(text: str, at: int) -> ParsedCall | None:
    """Read a list of Command-R, in whose words ``directly-answer`` is no call, and the fence after it."""
    call = json_call_at(text, at)
    if call.name in ("directly-answer", "directly_answer", "_"):
        return None
    end = skip_blanks(text, call.end)
    end = skip_blanks(text, end + 1) if text.startswith("]", end) else end
    return call._replace(end=end + 3) if not call.problem and text.startswith("```", end) else call
