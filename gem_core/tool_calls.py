"""How calls of tools are read: as JSON in the text of a response, and as native calls of a chat server."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from gem_core.nesting import is_deep
from gem_core.suggestions import did_you_mean
from gem_core.tools import CALL_CLOSE, CALL_OPEN, Tool, ToolCall
from gem_core.wrappers.views import call_id

_FORM = '{"name": "…", "arguments": {…}}'


def json_call(action: str, tools: Mapping[str, Tool]) -> ToolCall | None:
    """Return the first ``<tool_call>{"name": …, "arguments": …}</tool_call>`` of a response.

    A call that is not complete, no valid JSON, or of no tool has an ``error``.
    """
    start = action.find(CALL_OPEN)
    if start < 0:
        return None
    end = action.find(CALL_CLOSE, start)
    if end < 0:
        return ToolCall("", start=start, error=f"{CALL_OPEN} is never closed by {CALL_CLOSE}")
    stop = end + len(CALL_CLOSE)
    content, problem = _loaded(action[start + len(CALL_OPEN) : end])
    if problem is not None:
        return ToolCall(
            "", start=start, end=stop, error=f"between {CALL_OPEN} and {CALL_CLOSE} is no valid JSON: {problem}"
        )
    if not isinstance(content, dict) or not isinstance(content.get("name"), str):
        return ToolCall("", start=start, end=stop, error=f"a call must be an object of the form {_FORM}")
    name, arguments = content["name"], content.get("arguments", {})
    error = _problem(name, arguments, tools)
    return ToolCall(name[:100], {} if error else arguments, start, stop, error)


def native_calls(calls: Sequence[Mapping[str, Any]], tools: Mapping[str, Tool]) -> list[ToolCall]:
    """Return the native calls of a response, in order; one that cannot be read has an ``error``.

    Source: ``tool_calls`` of the OpenAI chat API, whose ``arguments`` are a string of JSON, possibly invalid.
    """
    return [_native_call(call, call_id(call, place), tools) for place, call in enumerate(calls)]


def _native_call(call: Any, call_id: str, tools: Mapping[str, Tool]) -> ToolCall:
    function = call.get("function", call.get("custom")) if isinstance(call, Mapping) else None
    if not isinstance(function, Mapping) or not isinstance(function.get("name"), str):
        return ToolCall("", id=call_id, error="a native call must name a function")
    name = function["name"]
    arguments, problem = _native_arguments(function, tools.get(name))
    error = problem or _problem(name, arguments, tools)
    return ToolCall(name[:100], {} if error else arguments, id=call_id, error=error)


def _native_arguments(function: Mapping[str, Any], tool: Tool | None) -> tuple[Any, str | None]:
    if "input" in function and tool is not None and tool.text_parameter is not None:
        # A custom tool of the API takes plain text.
        return {tool.text_parameter: function["input"]}, None
    arguments = function.get("arguments") or {}
    if not isinstance(arguments, str):
        try:
            arguments = json.dumps(arguments)  # what is no JSON could not be recorded
        except (TypeError, ValueError, RecursionError) as error:
            return None, f"its arguments are no valid JSON: {error}"[:200]
    content, problem = _loaded(arguments)
    return content, None if problem is None else f"its arguments are no valid JSON: {problem}"


def _problem(name: str, arguments: Any, tools: Mapping[str, Tool]) -> str | None:
    if name not in tools:
        return f"no tool {name[:100]!r}.{did_you_mean(name, tools)} There are: {', '.join(tools)}"
    if not isinstance(arguments, dict):
        return "its arguments must be an object of names and values"
    return None


def _loaded(text: str) -> tuple[Any, str | None]:
    try:
        content = json.loads(text, parse_float=_finite_number, parse_constant=_finite_number)
        return (None, "it is nested too deeply") if is_deep(content) else (content, None)
    except RecursionError:
        return None, "it is nested too deeply"
    except ValueError as error:
        return None, str(error)[:200]


def _finite_number(text: str) -> float:
    # Python reads NaN and 1e999, which no other reader of the recorded arguments would take.
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:20]} is no finite number")
    return number
