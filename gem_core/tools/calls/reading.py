"""``CallReader``: finds calls of tools in a response, as tags, fenced blocks or JSON; and native calls."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from gem_core.parsing import THINKING_MARKS, extract_code_blocks, extract_last_boxed_answer, without_thinking
from gem_core.records.turns import call_id
from gem_core.tools.calls import FORMATS, bare_call, format_call, format_calls, without_end_tokens
from gem_core.tools.calls.found import unknown
from gem_core.tools.calls.values import loaded, value_at
from gem_core.tools.tool import Tool, ToolCall, first_call, tags_of

WELL_KNOWN = ("python", "search")
"""Tags that models are trained to call tools by: such a tag is a call even where there is no such tool."""

_TAG = re.compile(r"<([A-Za-z][\w.-]{0,63}+)>", re.ASCII)
_MOST_TAGS = 50
"""Different tags of a response that are held against the names of tools."""
_MOST_QUOTED = 20
"""Calls of a response that are passed over because they are quoted."""

# A tag or another mark in quotation marks is only mentioned, and is no call.
_QUOTED_TAG = re.compile(r"""([`'"])(?:</?[^\s<>`'"]{1,64}+>|\[[A-Z_]{1,20}+\])\1""")
_BACKTICKS = re.compile(r"`++")
_LINE_BREAKS = re.compile(r"\n{3,}+")
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
        thinking_tag: Name of the tag around thinking; None where calls in it count as well.
    """

    def __init__(
        self,
        tools: Mapping[str, Tool],
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
        marks = [form.opening for form in FORMATS if form.clear]
        self._openings = (*marks, *(f"<{tool.name}>" for tool in self._tagged))
        names = "|".join(re.escape(tool.name) for tool in self._tagged)
        # With attributes, or closed in itself.
        self._other_tag = re.compile(rf"<({names})(?:\s++[\w-]++\s*+=[^<>]{{0,1000}}+|\s*+/)>") if names else None

    def find(self, action: str) -> ToolCall | None:
        """Return the first complete call, or the first that is begun; None for an answer to the task."""
        cut_off = getattr(action, "finish_reason", None) == "length"
        action = without_end_tokens(str.__str__(action))
        thinking, opened_before = thinking_blocks(action, self._thinking_tag)
        spoken = blank_out(action, thinking)
        answers = self._answers(spoken)
        quiet = [*thinking, *answers]
        call = self._visible(action, quiet, spoken)
        for _ in range(_MOST_QUOTED):
            if call is None or not self._is_quoted(spoken, call):
                break
            quiet.append((call.start, max(call.end, call.start + 1)))
            call = self._visible(action, quiet, spoken)
        else:
            return None
        if call is not None and call.cut:
            call = self._of_cut(action, call, cut_off)
        if call is not None and call.error is None:
            return call
        if opened_before:
            # What looks like the end of thinking may stand within a call, as in a program that prints it.
            around = self._visible(action, quiet[1:], spoken)
            if around is not None and around.error is None and around.end > thinking[0][1]:
                return around
        if call is None and thinking and not spoken.strip():
            thought = self._first(action, spoken)
            if thought is not None:
                error = (
                    f"it stands in a thinking block, where nothing is called; write it behind </{self._thinking_tag}>"
                )
                return ToolCall(thought.name, start=thought.start, end=thought.end, error=error)
        return call

    def _visible(self, action: str, quiet: Sequence[tuple[int, int]], spoken: str) -> ToolCall | None:
        """Return the first call that does not begin in a quiet part."""
        seen = blank_out(action, quiet)
        call = self._first(seen, spoken)
        if call is None or not any(call.start < start and (call.error or start < call.end) for start, _ in quiet):
            return call
        # A quiet part inside the call belongs to its arguments.
        return self._first(seen[: call.start] + action[call.start :], spoken)

    def _first(self, text: str, spoken: str) -> ToolCall | None:
        found: list[ToolCall | None] = []
        for tool in self._tagged:
            fences = not self.leaves_fences_of(tool)
            found.append(tool.parse(text, fences=fences))
            if tool.text_parameter is None:
                found.append(_object_in_tag(text, tool))
        found += format_calls(text, self._tools)
        call = first_call(found)
        if call is None or call.error is not None or text[: call.start].strip():  # else none can begin before it
            bare = bare_call(text, self._tools)
            # What looks like a call without any mark is none where the answer is given beside it.
            if bare is not None and not any(map(self._holds_answer, (spoken[: bare.start], spoken[bare.end :]))):
                call = first_call([call, bare])
        return call or self._misspelt(text) or self._with_attributes(text)

    def _of_cut(self, action: str, call: ToolCall, cut_off: bool) -> ToolCall:
        """Return a call that the text ends in: whole where a stop string took its end, else with its error."""
        content, error = action[call.start :], call.error
        if cut_off:
            error = f"{call.error}: the response was cut off at the limit of its length"
        elif "\\boxed{" not in content and not any(f"<{tag}>" in content for tag in self._answer_tags):
            return replace(call, error=None, cut=False)
        return replace(call, arguments={}, error=error, cut=False)

    def _holds_answer(self, text: str) -> bool:
        """Tell whether a final answer stands in a text."""
        if "\\boxed" in text and extract_last_boxed_answer(text) is not None:
            return True
        return any(True for tag in self._answer_tags for _ in _elements(text, tag))

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
                return self._holds_answer(text[: block.start]) or self._holds_answer(text[block.end :])
        behind = [line.rfind(mark) for mark in ("\\boxed", *(f"</{tag}>" for tag in self._answer_tags))]
        if max(behind) < 0:
            return False
        said = line[max(behind) :]
        said = said[max(said.rfind("}"), said.find(">")) + 1 :]
        return any(char.isalpha() for char in said) and _END_OF_SENTENCE.search(said) is None

    def leaves_fences_of(self, tool: Tool) -> bool:
        """Tell whether fenced blocks that would call a tool are the task's answers."""
        return not self._answer_fences.isdisjoint(map(str.casefold, tool.fences))

    def _answers(self, text: str) -> list[tuple[int, int]]:
        """Return the parts that are answers of the task, and the tags that are only spoken of."""
        found = [quoted.span() for quoted in _QUOTED_TAG.finditer(text)]
        if self._answer_fences:
            found += [(block.start, block.end) for block in extract_code_blocks(text, *self._answer_fences)]
        for tag in self._answer_tags:
            found += [
                (start, end)
                for start, end in _elements(text, tag)
                if not text[start + len(tag) + 2 : end].lstrip().startswith(self._openings)
            ]
        return found

    def _with_attributes(self, text: str) -> ToolCall | None:
        """Return a tag with a tool's name that has attributes or closes itself, as a call with an error."""
        tag = self._other_tag.search(text) if self._other_tag else None
        if tag is None:
            return None
        name = tag[1]
        error = f"its tag takes no attributes; what it is given is written between <{name}> and </{name}>"
        return ToolCall(name, {}, tag.start(), tag.end(), error)

    def _misspelt(self, text: str) -> ToolCall | None:
        """Return an element whose tag is a misspelt name of a tool, as a call with an error."""
        if not self._tools:
            return None
        names = [tool.name for tool in self._tagged]
        tried = set(self.reserved)
        for tag in _TAG.finditer(text):
            name = tag[1]
            if name in tried:
                continue
            tried.add(name)
            if len(tried) > _MOST_TAGS:
                break
            if name not in self._tools and (name in WELL_KNOWN or any(_one_slip(name, each) for each in names)):
                closing = f"</{name}>"
                end = text.find(closing, tag.end())
                if end >= 0:
                    return ToolCall(name, {}, tag.start(), end + len(closing), unknown(name, self._tools))
        return None


def json_call(action: str, tools: Mapping[str, Tool]) -> ToolCall | None:
    """Return the first ``<tool_call>{"name": …, "arguments": …}</tool_call>`` of a response.

    A call that is not complete, no valid JSON, or of no tool has an ``error``. What other families of models write in
    this tag is read as well; see ``gem_core.tools.calls``.
    """
    return format_call(FORMATS[0], action, tools)


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
    content, problem = loaded(arguments)
    return content, None if problem is None else f"its arguments are no valid JSON: {problem}"


def _problem(name: str, arguments: Any, tools: Mapping[str, Tool]) -> str | None:
    if name not in tools:
        return unknown(name, tools)
    if not isinstance(arguments, dict):
        return "its arguments must be an object of names and values"
    return None


def _object_in_tag(text: str, tool: Tool) -> ToolCall | None:
    """Return a call of a tool without a text form that is written as a tag all the same, around its arguments."""
    if tool.name not in text:
        return None
    opening_tag, closing_tag = tags_of(tool.name)
    opening = opening_tag.search(text)
    if opening is None:
        return None
    start = opening.start()
    try:
        # As far as the JSON goes, since a string in it may hold the closing tag.
        arguments, behind = value_at(text, opening.end())
    except ValueError:
        arguments, behind = None, opening.end()
    closing = closing_tag.search(text, behind)
    if closing is None:
        return ToolCall(tool.name, start=start, error=f"<{tool.name}> is never closed by </{tool.name}>")
    if not text[opening.end() : closing.start()].strip():
        return ToolCall(tool.name, {}, start, closing.end())
    if not isinstance(arguments, dict) or text[behind : closing.start()].strip():
        error = f"between <{tool.name}> and </{tool.name}> must stand its arguments as a JSON object"
        return ToolCall(tool.name, {}, start, closing.end(), error)
    return ToolCall(tool.name, arguments, start, closing.end())


def _open_backticks(line: str) -> str:
    """Return the backticks that are open at the end of a line, as Markdown pairs them; empty without any."""
    mark = ""
    for run in _BACKTICKS.finditer(line):
        if not mark and (len(run[0]) < 3 or line[: run.start()].strip()):
            mark = run[0]
        elif run[0] == mark:
            mark = ""
    return mark


def thinking_blocks(action: str, tag: str | None = "think") -> tuple[list[tuple[int, int]], bool]:
    """Return the closed thinking blocks, and whether the first was opened before the response, as templates do."""
    if tag is None:
        return [], False
    opening, closing = f"<{tag}>", f"</{tag}>"
    spans, opened_before = [], False
    end = action.find(closing)
    if end >= 0:
        opened_before = not 0 <= action.find(opening) < end
        if opened_before:
            spans.append((0, end + len(closing)))
    spans += _blocks(action, opening, closing, spans[0][1] if spans else 0)
    for marks in THINKING_MARKS:
        if marks[0] in action:
            spans += _blocks(action, *marks, 0)
    return spans, opened_before


def spoken(action: str, tag: str = "think") -> str:
    """Return what a response says to other agents: its text without thinking, whether or not the block is closed."""
    text = without_end_tokens(str.__str__(action))
    thinking = thinking_blocks(text, tag)[0]
    if thinking:
        text = _LINE_BREAKS.sub("\n\n", blank_out(text, thinking))
    return without_thinking(text, tag).strip()


def _blocks(text: str, opening: str, closing: str, at: int) -> Iterator[tuple[int, int]]:
    while (start := text.find(opening, at)) >= 0:
        end = text.find(closing, start)
        if end < 0:
            return
        at = end + len(closing)
        yield start, at


def _elements(text: str, tag: str) -> Iterator[tuple[int, int]]:
    """Yield where the elements of a tag begin and end, each from the last opening tag before its end."""
    opening, closing = f"<{tag}>", f"</{tag}>"
    behind = 0
    while (end := text.find(closing, behind)) >= 0:
        start = text.rfind(opening, behind, end)
        behind = end + len(closing)
        if start >= 0:
            yield start, behind


def blank_out(action: str, spans: Collection[tuple[int, int]]) -> str:
    """Return the text with line breaks in place of some parts, so that all else stays where it is."""
    if not spans:
        return action
    pieces, position = [], 0
    for start, end in sorted(spans):
        if end > position:
            pieces += [action[position:start], "\n" * (end - max(start, position))]
            position = end
    return "".join([*pieces, action[position:]])


def _one_slip(written: str, name: str) -> bool:
    """Tell whether two names differ, except in case, by one extra, missing or wrong letter or two exchanged."""
    written, name = written.casefold(), name.casefold()
    if written == name:
        return True
    if min(len(written), len(name)) < 5:
        return False
    while written and name and written[0] == name[0]:
        written, name = written[1:], name[1:]
    while written and name and written[-1] == name[-1]:
        written, name = written[:-1], name[:-1]
    return max(len(written), len(name)) <= 1 or (len(written) == 2 and written == name[::-1])
