"""Finds the call of a tool in a response: as JSON, in the tool's own tag or fenced block, or in a plugin's format.

A native call (``Response.tool_calls``) is read by ``native_calls``. In text, ``CallReader`` masks what is thought,
answered or quoted, asks each reader for its first call, and takes the one that begins first. The readers are
``json_call``, ``Tool.parse``, and those of the formats that plugins offer (see ``CallFormatSpec``).

Everything here takes any text at all and needs time in proportion to its length.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, cast

from gem_core.parsing import (
    extract_code_blocks,
    extract_last_boxed_answer,
    extract_last_tagged_answer,
    mask,
    thinking_blocks,
    without_end_tokens,
)
from gem_core.records.conversation import call_id
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.specs import CallFormatSpec
from gem_core.suggestions import did_you_mean
from gem_core.tools.tool import CALL_CLOSE, CALL_OPEN, Tool, ToolCall, first_call

Tools = Mapping[str, Tool]

_MOST_DEEP = 100
"""Levels of lists and objects that arguments may have: more cannot be recorded."""
_MOST_OPENINGS = 20
"""Openings of one format that are tried if they turn out not to begin a call."""

_QUOTED = re.compile(r"""(?<!`)(`{1,2})(?!`)[^`\n]++\1(?!`)|(["'])</?[^\s<>"']{1,64}>\2""")
"""Markdown's code within a line, and a lone tag in quotation marks: a call there is only mentioned."""


class CallReader:
    """Finds the call in the text of a response.

    What stands in a thinking block was thought and not called, unless the block is never closed, as where the server
    stopped at the call. What stands in a fenced block or a tag that is the task's answer is part of the answer, unless
    that begins with a call. What stands in backticks within a line is mentioned, unless that is the whole response.

    Args:
        tools: By name.
        answer_fences: Languages of the blocks in which the task is answered.
        answer_tags: Tags in which the task is answered; a tool of such a name is called in JSON only.
        thinking_tag: Name of the tag around thinking; None if calls in it count as well.
    """

    def __init__(
        self,
        tools: Tools,
        *,
        answer_fences: Iterable[str] = (),
        answer_tags: Iterable[str] = (),
        thinking_tag: str | None = "think",
    ) -> None:
        self._tools = tools
        self._answer_fences = {language.casefold() for language in answer_fences}
        self._answer_tags = tuple(answer_tags)
        self._thinking_tag = thinking_tag
        self.reserved = {*self._answer_tags, *([] if thinking_tag is None else [thinking_tag]), "tool_call"}

    def find(self, action: str) -> ToolCall | None:
        """Return the first complete call, or the first that is begun; None for an answer to the task."""
        text = without_end_tokens(str.__str__(action))
        thinking, _ = thinking_blocks(text, self._thinking_tag)
        visible = mask(text, thinking)
        mentions = [found.span() for found in _QUOTED.finditer(visible) if found[0] != visible.strip()]
        hidden = [*thinking, *self._answers(visible), *mentions]
        seen = mask(text, hidden)
        call = self._first(seen, visible)
        if call is not None and any(call.start < start < call.end for start, _ in hidden):
            # A hidden part inside the call belongs to its arguments.
            call = self._first(seen[: call.start] + text[call.start :], visible)
        if call is None or not call.cut:
            return call
        if getattr(action, "finish_reason", None) == "length":
            error = f"{call.error}: the response was cut off at the limit of its length"
            return replace(call, arguments={}, error=error, cut=False)
        return replace(call, error=None, cut=False)  # a stop string took its end

    def leaves_fences_of(self, tool: Tool) -> bool:
        """Tell whether fenced blocks that would call a tool are the task's answers."""
        return not self._answer_fences.isdisjoint(map(str.casefold, tool.fences))

    @functools.cached_property
    def _formats(self) -> list[CallFormatSpec]:
        return registry().specs(CallFormatSpec)  # not before it is needed, since plugins are loaded for it

    def _first(self, text: str, visible: str) -> ToolCall | None:
        """Ask every reader, and return the first call."""
        tools = [tool for tool in self._tools.values() if tool.name not in self.reserved]
        found = [tool.parse(text, fences=not self.leaves_fences_of(tool)) for tool in tools]
        for form in self._formats:
            call = _first_of(form, text, self._tools)
            # What has the shape of an answer is no call where the answer is given beside it.
            if not (call and form.begins == "anything" and self._answered(visible[: call.start], visible[call.end :])):
                found.append(call)
        return first_call([*found, json_call(text, self._tools)])

    def _answers(self, text: str) -> Iterator[tuple[int, int]]:
        """Yield where the task's answers begin and end; a tag from the last opening before its end."""
        if self._answer_fences:
            for block in extract_code_blocks(text, *self._answer_fences):
                yield block.start, block.end
        for tag in self._answer_tags:
            behind = 0
            while (end := text.find(f"</{tag}>", behind)) >= 0:
                start = text.rfind(f"<{tag}>", behind, end)
                behind = end + len(tag) + 3
                if start >= 0 and not self._begins_with_call(text[start + len(tag) + 2 : end].lstrip()):
                    yield start, behind

    def _begins_with_call(self, content: str) -> bool:
        """Tell whether an answer is a call in truth, as some model families write it."""
        begun = (form.begins == "calls" and re.match(form.opening, content) for form in self._formats)
        return content.startswith((CALL_OPEN, *(f"<{name}>" for name in self._tools))) or any(begun)

    def _answered(self, *texts: str) -> bool:
        """Tell whether a final answer stands in one of some texts."""
        return any(
            extract_last_boxed_answer(text) is not None
            or any(extract_last_tagged_answer(text, tag) is not None for tag in self._answer_tags)
            for text in texts
        )


# The formats of plugins.


def _first_of(form: CallFormatSpec, text: str, tools: Tools) -> ToolCall | None:
    """Return the first call in a plugin's format, whose reader is not imported before a response has its opening."""
    for opening in itertools.islice(re.finditer(form.opening, text), _MOST_OPENINGS):
        read: Callable[..., ToolCall | None] = load_entry_point(form.entry_point, f"{form.kind} {form.name!r}")
        call = read(opening, tools)
        if call is not None:
            return call
    return None


def format_calls(text: str, tools: Tools) -> list[ToolCall]:
    """Return the first call in JSON and in each format of plugins; one that cannot be read has an ``error``."""
    found = [_first_of(form, text, tools) for form in registry().specs(CallFormatSpec) if form.begins != "anything"]
    return [call for call in (*found, json_call(text, tools)) if call is not None]


# JSON.


def json_call(action: str, tools: Tools) -> ToolCall | None:
    """Return the first ``<tool_call>{"name": …, "arguments": …}</tool_call>`` of a response.

    Only one value is decoded, so that it may hold what looks like its end; the closing tag may be missing, where the
    server stopped at it. A call that cannot be read, or is of no tool, has an ``error``.
    """
    start = action.find(CALL_OPEN)
    if start < 0:
        return None
    at = start + len(CALL_OPEN)
    try:
        value, end = json_at(action, at)
    except ValueError as error:
        closing = action.find(CALL_CLOSE, at)
        if closing < 0:
            return ToolCall("", start=start, error=f"{CALL_OPEN} is never closed by {CALL_CLOSE}")
        wrong = f"between {CALL_OPEN} and {CALL_CLOSE} is no valid JSON: {error}"[:250]
        return ToolCall("", start=start, end=closing + len(CALL_CLOSE), error=wrong)
    closing = action.find(CALL_CLOSE, end)
    if closing >= 0 and not action[end:closing].strip():
        end = closing + len(CALL_CLOSE)
    if not isinstance(value, dict) or not isinstance(value.get("name"), str):
        wrong = 'a call must be an object of the form {"name": "…", "arguments": {…}}'
        return ToolCall("", start=start, end=end, error=wrong)
    return described_call(value["name"], value.get("arguments", value.get("parameters")), tools, start, end)


def described_call(name: str, given: Any, tools: Tools, start: int, end: int) -> ToolCall:
    """Return the call of a tool by its name and arguments; with an ``error`` if there is none or they do not fit.

    Args:
        name: Of the tool.
        given: An object; or text, which is JSON or what the tool's text parameter takes.
        tools: By name.
        start: Index in the response where the call begins.
        end: Index after its last character.
    """
    tool, problem = tools.get(name), None
    if tool is None:
        return ToolCall(name[:100], {}, start, end, unknown_tool(name, tools))
    if isinstance(given, str) and tool.text_parameter is not None and not given.lstrip().startswith("{"):
        given = {tool.text_parameter: given}
    elif isinstance(given, str):
        given, problem = _loaded(given)
    given = {} if given is None and problem is None else given
    if problem is None and not isinstance(given, dict):
        problem = "its arguments must be an object of names and values"
    return ToolCall(name[:100], {} if problem else given, start, end, problem)


def unknown_tool(name: str, tools: Tools) -> str:
    """Return the error of a call that names no tool."""
    return f"no tool {name[:100]!r}.{did_you_mean(name[:100], tools)} There are: {', '.join(tools) or 'none'}"


def json_at(text: str, at: int) -> tuple[Any, int]:
    """Return the JSON value that begins at a place, white space apart, and the index after it.

    Raises:
        ValueError: There is none.
    """
    value, end, depth = None, at, _MOST_DEEP + 1
    with suppress(RecursionError):
        value, end = _DECODER.raw_decode(text, cast("re.Match[str]", _BLANKS.match(text, at)).end())
        depth = _depth(value)
    if depth > _MOST_DEEP:
        raise ValueError("it is nested too deeply")
    return value, end


def _depth(value: Any) -> int:
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + max(map(_depth, parts), default=0)


def _loaded(text: str) -> tuple[Any, str | None]:
    try:
        value, end = json_at(text, 0)
        if text[end:].strip():
            raise ValueError(f"Extra data behind {text[:end].strip()[-20:]!r}")
        return value, None
    except ValueError as error:
        return None, f"its arguments are no valid JSON: {error}"[:220]


def _finite_number(text: str) -> float:
    # Python reads NaN and 1e999, which no other reader of the recorded arguments would take.
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:20]} is no finite number")
    return number


_BLANKS = re.compile(r"\s*+")
# Not strict: a program of several lines may stand in a string with its line breaks as they are.
_DECODER = json.JSONDecoder(strict=False, parse_float=_finite_number, parse_constant=_finite_number)


# Native calls.


def native_calls(calls: Sequence[Mapping[str, Any]], tools: Tools) -> list[ToolCall]:
    """Return the native calls of a response, in order; one that cannot be read has an ``error``.

    Source: ``tool_calls`` of the OpenAI chat API, whose ``arguments`` are a string of JSON, possibly invalid.
    """
    return [_native_call(call, call_id(call, place), tools) for place, call in enumerate(calls)]


def _native_call(call: Any, call_id: str, tools: Tools) -> ToolCall:
    function = call.get("function") if isinstance(call, Mapping) else None
    if not isinstance(function, Mapping) or not isinstance(function.get("name"), str):
        return ToolCall("", id=call_id, error="a native call must name a function")
    arguments = function.get("arguments") or {}
    try:
        # What is no JSON could not be recorded.
        arguments, problem = _loaded(arguments if isinstance(arguments, str) else json.dumps(arguments))
    except (TypeError, ValueError, RecursionError) as error:
        problem = f"its arguments are no valid JSON: {error}"[:220]
    if problem is not None:
        return ToolCall(function["name"][:100], id=call_id, error=problem)
    arguments = [arguments] if isinstance(arguments, str) else arguments  # JSON that is a text is no object
    return replace(described_call(function["name"], arguments, tools, 0, 0), id=call_id)
