"""Finds the call of a tool in a response: as JSON, in the tool's own tag or fenced block, or in a plugin's format.

A native call (``Response.tool_calls``) is read by ``native_calls``. In text, ``CallReader`` masks what is thought
or answered, asks each reader for its first call, and takes the one that begins first. The readers are ``json_call``,
``Tool.parse``, and those of the formats that plugins offer (see ``CallFormatSpec``).

Everything here takes any text at all and needs time in proportion to its length.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

from gem_core.parsing import (
    extract_code_blocks,
    extract_last_boxed_answer,
    mask,
    thinking_blocks,
    without_end_tokens,
)
from gem_core.records.conversation import call_id
from gem_core.records.plain_json import is_deep
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.specs import CallFormatSpec
from gem_core.suggestions import did_you_mean, one_slip
from gem_core.tools.tool import CALL_CLOSE, CALL_OPEN, Tool, ToolCall, first_call, tags_of

Tools = Mapping[str, Tool]

WELL_KNOWN = ("python", "search")
"""Tags that models are trained to call tools by: such a tag is a call even if there is no such tool."""

_TAG = re.compile(r"<([A-Za-z][\w.-]{0,63}+)>", re.ASCII)
_MOST_TAGS = 50
"""Different tags of a response that are held against the names of tools."""
_MOST_OPENINGS = 20
"""Openings of one format that are tried if they turn out not to begin a call."""
_MOST_QUOTED = 20
"""Calls of a response that are passed over because they are quoted."""

# A tag or another mark in quotation marks is only mentioned, and is no call.
_QUOTED_TAG = re.compile(r"""([`'"])(?:</?[^\s<>`'"]{1,64}+>|\[[A-Z_]{1,20}+\])\1""")
_BACKTICKS = re.compile(r"`++")
_END_OF_SENTENCE = re.compile(r"[.!?](?=\s|\Z)")


class CallReader:
    """Finds the call in the text of a response.

    What stands in a thinking block was thought and not called, unless the block is never closed, as where the server
    stopped at the call. What stands in a fenced block or a tag that is the task's answer is part of the answer, unless
    that begins with a call. A lone tag in quotation marks, as in "`<search>`", is none; nor is a call in backticks, one
    in a sentence that holds the final answer already, or one within a fenced block beside the final answer.

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
        self._tagged = [tool for tool in tools.values() if tool.name not in self.reserved]
        self._tags = tuple(f"<{tool.name}>" for tool in self._tagged)
        names = "|".join(re.escape(tool.name) for tool in self._tagged)
        # With attributes, or closed in itself.
        self._other_tag = re.compile(rf"<({names})(?:\s++[\w-]++\s*+=[^<>]{{0,1000}}+|\s*+/)>") if names else None

    def find(self, action: str) -> ToolCall | None:
        """Return the first complete call, or the first that is begun; None for an answer to the task."""
        cut_off = getattr(action, "finish_reason", None) == "length"
        action = without_end_tokens(str.__str__(action))
        thinking, opened_before = thinking_blocks(action, self._thinking_tag)
        visible = mask(action, thinking)
        ignored = [*thinking, *self._answers(visible)]
        call = self._first_visible(action, ignored, visible)
        for _ in range(_MOST_QUOTED):
            if call is None or not self._is_quoted(visible, call):
                break
            ignored.append((call.start, max(call.end, call.start + 1)))
            call = self._first_visible(action, ignored, visible)
        else:
            return None
        if call is not None and call.cut:
            call = self._of_cut(action, call, cut_off)
        if call is not None and call.error is None:
            return call
        if opened_before:
            # What looks like the end of thinking may stand within a call, as in a program that prints it.
            around = self._first_visible(action, ignored[1:], visible)
            if around is not None and around.error is None and around.end > thinking[0][1]:
                return around
        if call is None and thinking and not visible.strip():
            thought = self._first(action, visible)
            if thought is not None:
                error = (
                    f"it stands in a thinking block, where nothing is called; write it behind </{self._thinking_tag}>"
                )
                return ToolCall(thought.name, start=thought.start, end=thought.end, error=error)
        return call

    def leaves_fences_of(self, tool: Tool) -> bool:
        """Tell whether fenced blocks that would call a tool are the task's answers."""
        return not self._answer_fences.isdisjoint(map(str.casefold, tool.fences))

    # Asking the readers.

    @functools.cached_property
    def _formats(self) -> list[CallFormatSpec]:
        return registry().specs(CallFormatSpec)  # not before it is needed, since plugins are loaded for it

    def _first_visible(self, action: str, ignored: Sequence[tuple[int, int]], visible: str) -> ToolCall | None:
        """Return the first call that does not begin in an ignored part."""
        seen = mask(action, ignored)
        call = self._first(seen, visible)
        if call is None or not any(call.start < start and (call.error or start < call.end) for start, _ in ignored):
            return call
        # An ignored part inside the call belongs to its arguments.
        return self._first(seen[: call.start] + action[call.start :], visible)

    def _first(self, text: str, visible: str) -> ToolCall | None:
        found: list[ToolCall | None] = []
        for tool in self._tagged:
            found.append(tool.parse(text, fences=not self.leaves_fences_of(tool)))
            if tool.text_parameter is None:
                found.append(_object_in_tag(text, tool))
        for form in self._formats:
            call = _first_of(form, text, self._tools)
            # What has the shape of an answer is no call where the answer is given beside it.
            if not (call and form.begins == "anything" and self._answered(visible[: call.start], visible[call.end :])):
                found.append(call)
        found.append(json_call(text, self._tools))
        return first_call(found) or self._misspelt(text) or self._with_attributes(text)

    def _of_cut(self, action: str, call: ToolCall, cut_off: bool) -> ToolCall:
        """Return a call that the text ends in: whole where a stop string took its end, else with its error."""
        content, error = action[call.start :], call.error
        if cut_off:
            error = f"{call.error}: the response was cut off at the limit of its length"
        elif "\\boxed{" not in content and not any(f"<{tag}>" in content for tag in self._answer_tags):
            return replace(call, error=None, cut=False)
        return replace(call, arguments={}, error=error, cut=False)

    def _misspelt(self, text: str) -> ToolCall | None:
        """Return an element whose tag is a misspelt name of a tool, as a call with an error."""
        names, tried = [tool.name for tool in self._tagged], {*self.reserved}
        for tag in _TAG.finditer(text) if self._tools else ():
            name = tag[1]
            if name in tried or len(tried) > _MOST_TAGS:
                continue
            tried.add(name)
            closing = f"</{name}>"
            meant = name not in self._tools and (name in WELL_KNOWN or any(one_slip(name, each) for each in names))
            if meant and (end := text.find(closing, tag.end())) >= 0:
                return ToolCall(name, {}, tag.start(), end + len(closing), unknown_tool(name, self._tools))
        return None

    def _with_attributes(self, text: str) -> ToolCall | None:
        """Return a tag with a tool's name that has attributes or closes itself, as a call with an error."""
        tag = self._other_tag.search(text) if self._other_tag else None
        if tag is None:
            return None
        error = f"its tag takes no attributes; what it is given is written between <{tag[1]}> and </{tag[1]}>"
        return ToolCall(tag[1], {}, tag.start(), tag.end(), error)

    # Answers, quotations and mentions.

    def _answers(self, text: str) -> list[tuple[int, int]]:
        """Return the spans of the task's answers and of quoted tags, in which no call begins."""
        found = [quoted.span() for quoted in _QUOTED_TAG.finditer(text)]
        if self._answer_fences:
            found += [(block.start, block.end) for block in extract_code_blocks(text, *self._answer_fences)]
        for tag in self._answer_tags:
            found += [
                (start, end)
                for start, end in _elements(text, tag)
                if not self._begins_with_call(text[start + len(tag) + 2 : end].lstrip())
            ]
        return found

    def _begins_with_call(self, content: str) -> bool:
        begun = (form.begins == "calls" and re.match(form.opening, content) for form in self._formats)
        return content.startswith((CALL_OPEN, *self._tags)) or any(begun)

    def _answered(self, *texts: str) -> bool:
        """Tell whether a final answer stands in one of some texts."""
        return any(
            ("\\boxed" in text and extract_last_boxed_answer(text) is not None)
            or any(True for tag in self._answer_tags for _ in _elements(text, tag))
            for text in texts
        )

    def _is_quoted(self, text: str, call: ToolCall) -> bool:
        """Tell whether a call is only mentioned: in backticks, or in a sentence that holds the final answer already."""
        end = max(call.end, call.start + 1)
        line = text[text.rfind("\n", 0, call.start) + 1 : call.start]
        mark = _open_backticks(line)
        if mark:
            stop = text.find("\n", end)
            rest = text[end : stop if stop >= 0 else len(text)]
            if any(run[0] == mark for run in _BACKTICKS.finditer(rest)):
                return text.strip().strip("`").strip() != text[call.start : call.end].strip()
        # A block that shows a call, in a response that answers outside of it; what a fence itself calls begins with it.
        for block in extract_code_blocks(text):
            if block.start < call.start and end <= block.end:
                return self._answered(text[: block.start], text[block.end :])
        behind = [line.rfind(mark) for mark in ("\\boxed", *(f"</{tag}>" for tag in self._answer_tags))]
        if max(behind) < 0:
            return False
        words = line[max(behind) :]
        words = words[max(words.rfind("}"), words.find(">")) + 1 :]
        return any(char.isalpha() for char in words) and _END_OF_SENTENCE.search(words) is None


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
    closing = action.find(CALL_CLOSE, at)
    behind = closing + len(CALL_CLOSE) if closing >= 0 else 0
    try:
        value, end = json_at(action, at)
    except ValueError as error:
        wrong = f"between {CALL_OPEN} and {CALL_CLOSE} is no valid JSON: {error}"[:250]
        never = f"{CALL_OPEN} is never closed by {CALL_CLOSE}"
        return ToolCall("", {}, start, behind, wrong if behind else never)
    closing = action.find(CALL_CLOSE, end)
    extra = action[end : max(closing, end)].strip()
    behind = closing + len(CALL_CLOSE) if closing >= 0 and not extra else end
    if extra[:1].isalnum():
        wrong = f"between {CALL_OPEN} and {CALL_CLOSE} is no valid JSON: Extra data behind it"
        return ToolCall("", {}, start, closing + len(CALL_CLOSE), wrong)
    if not isinstance(value, dict) or not isinstance(value.get("name"), str):
        wrong = 'a call must be an object of the form {"name": "…", "arguments": {…}}'
        return ToolCall("", {}, start, behind, wrong)
    return described_call(value["name"], value.get("arguments", value.get("parameters")), tools, start, behind)


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
    try:
        value, end = _DECODER.raw_decode(text, cast("re.Match[str]", _BLANKS.match(text, at)).end())
    except RecursionError:
        value, end = None, -1
    if end < 0 or is_deep(value):
        raise ValueError("it is nested too deeply")
    return value, end


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
    function = call.get("function", call.get("custom")) if isinstance(call, Mapping) else None
    if not isinstance(function, Mapping) or not isinstance(function.get("name"), str):
        return ToolCall("", id=call_id, error="a native call must name a function")
    name = function["name"]
    tool, problem = tools.get(name), None
    arguments = function.get("arguments") or {}
    if "input" in function and tool is not None and tool.text_parameter is not None:
        arguments = {tool.text_parameter: function["input"]}  # a custom tool of the API takes plain text
    else:
        try:
            # What is no JSON could not be recorded.
            arguments, problem = _loaded(arguments if isinstance(arguments, str) else json.dumps(arguments))
        except (TypeError, ValueError, RecursionError) as error:
            problem = f"its arguments are no valid JSON: {error}"[:220]
    if problem is not None:
        return ToolCall(name[:100], id=call_id, error=problem)
    if isinstance(arguments, str):
        arguments = [arguments]  # JSON that is a text is no object
    return replace(described_call(name, arguments, tools, 0, 0), id=call_id)


# Tags.


def _object_in_tag(text: str, tool: Tool) -> ToolCall | None:
    """Return a call of a tool without a text form that is written as a tag all the same, around its arguments."""
    opening_tag, closing_tag = tags_of(tool.name)
    opening = opening_tag.search(text) if tool.name in text else None
    if opening is None:
        return None
    try:
        # As far as the JSON goes, since a string in it may hold the closing tag.
        arguments, behind = json_at(text, opening.end())
    except ValueError:
        arguments, behind = None, opening.end()
    closing = closing_tag.search(text, behind)
    if closing is None:
        return ToolCall(tool.name, {}, opening.start(), 0, f"<{tool.name}> is never closed by </{tool.name}>")
    if not text[opening.end() : closing.start()].strip():
        return ToolCall(tool.name, {}, opening.start(), closing.end())
    if not isinstance(arguments, dict) or text[behind : closing.start()].strip():
        error = f"between <{tool.name}> and </{tool.name}> must stand its arguments as a JSON object"
        return ToolCall(tool.name, {}, opening.start(), closing.end(), error)
    return ToolCall(tool.name, arguments, opening.start(), closing.end())


def _elements(text: str, tag: str) -> Iterator[tuple[int, int]]:
    """Yield where the elements of a tag begin and end, each from the last opening tag before its end."""
    opening, closing = f"<{tag}>", f"</{tag}>"
    behind = 0
    while (end := text.find(closing, behind)) >= 0:
        start = text.rfind(opening, behind, end)
        behind = end + len(closing)
        if start >= 0:
            yield start, behind


def _open_backticks(line: str) -> str:
    """Return the backticks that are open at the end of a line, as Markdown pairs them; empty without any."""
    mark = ""
    for run in _BACKTICKS.finditer(line):
        if not mark and (len(run[0]) < 3 or line[: run.start()].strip()):
            mark = run[0]
        elif run[0] == mark:
            mark = ""
    return mark
