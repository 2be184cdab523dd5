"""How calls of tools are read: in the text of a response as tags, fenced blocks or JSON, and as native calls."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from gem_core.nesting import is_deep
from gem_core.parsing import extract_code_blocks
from gem_core.suggestions import did_you_mean
from gem_core.tools import CALL_CLOSE, CALL_OPEN, Tool, ToolCall, first_call
from gem_core.wrappers.views import call_id

WELL_KNOWN = ("python", "search")
"""Tags that models are trained to call tools by: such a tag is a call even where there is no such tool."""

_FORM = '{"name": "…", "arguments": {…}}'
_NAMES = ("name", "tool_name", "function")
_ARGUMENTS = ("arguments", "parameters")
_TAG = re.compile(r"<([A-Za-z][\w.-]{0,63}+)>", re.ASCII)
_MOST_TAGS = 50
"""Different tags of a response that are held against the names of tools."""

# A tag in quotation marks is spoken of, and is none.
_QUOTED_TAG = re.compile(r"""([`'"])</?[A-Za-z][\w.-]{0,63}+>\1""", re.ASCII)
_JSON_OUTSIDE = re.compile(
    r'\{\s*+"(?:name|tool_name|function)"\s*+:\s*+"([^"\\]{1,100}+)"\s*+,\s*+"(?:arguments|parameters)"\s*+:'
)
_SPACE = re.compile(r"\s*+")
_END_OF_CALL = re.compile(rf"\s*+{re.escape(CALL_CLOSE)}")
_ELEMENTS = re.compile(r"\s*+<tool_name>(.*?)</tool_name>(.*)", re.DOTALL)
# The closing quote is optional, so that a text that is never closed is read once, and not again from each quote in it.
_STRING_OR_LAST_COMMA = re.compile(r'"(?:[^"\\]|\\.)*+"?|,(?=\s*+[}\]])', re.DOTALL)


class CallReader:
    """Finds the call in the text of a response.

    What stands in a thinking block was thought and not called, unless the block is never closed, as where the server
    stopped at the call. What stands in a fenced block or a tag that is the task's answer is part of the answer, unless
    that begins with a call. A lone tag in quotation marks, as in "`<search>`", is none.

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
        self._openings = (CALL_OPEN, *(f"<{tool.name}>" for tool in self._tagged))
        names = "|".join(re.escape(tool.name) for tool in self._tagged)
        # With attributes, closed in itself, or with white space before its end.
        self._other_tag = re.compile(rf"<({names})(?:\s++[\w-]++\s*+=[^<>]{{0,1000}}+|\s*+/|\s++)>") if names else None

    def find(self, action: str) -> ToolCall | None:
        """Return the first complete call, or the first that is begun; None for an answer to the task."""
        action = str.__str__(action)
        thinking, opened_before = _thinking(action, self._thinking_tag)
        quiet = [*thinking, *self._answers(_blanked(action, thinking))]
        call = self._visible(action, quiet)
        if call is not None and call.error is None:
            return call
        if opened_before:
            # What looks like the end of thinking may stand within a call, as in a program that prints it.
            around = self._visible(action, quiet[1:])
            if around is not None and around.error is None and around.end > thinking[0][1]:
                return around
        if call is None and thinking and not _blanked(action, thinking).strip():
            thought = self._first(action)
            if thought is not None:
                error = (
                    f"it stands in a thinking block, where nothing is called; write it behind </{self._thinking_tag}>"
                )
                return ToolCall(thought.name, start=thought.start, end=thought.end, error=error)
        return call

    def _visible(self, action: str, quiet: Sequence[tuple[int, int]]) -> ToolCall | None:
        """Return the first call that does not begin in a quiet part."""
        seen = _blanked(action, quiet)
        call = self._first(seen)
        if call is None or not any(call.start < start and (call.error or start < call.end) for start, _ in quiet):
            return call
        # A quiet part inside the call belongs to its arguments.
        return self._first(seen[: call.start] + action[call.start :])

    def _first(self, text: str) -> ToolCall | None:
        found = [json_call(text, self._tools)]
        for tool in self._tagged:
            fences = not self.leaves_fences_of(tool)
            found.append(tool.parse(text, fences=fences))
            if tool.text_parameter is None:
                found.append(_object_in_tag(text, tool))
        return first_call(found) or self._misspelt(text) or self._malformed(text)

    def leaves_fences_of(self, tool: Tool) -> bool:
        """Tell whether fenced blocks that would call a tool are the task's answers."""
        return any(language.casefold() in self._answer_fences for language in tool.fences)

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

    def _malformed(self, text: str) -> ToolCall | None:
        """Return what was surely meant for a tool, in a form that is none: a tag with attributes, or JSON alone."""
        tag = self._other_tag.search(text) if self._other_tag else None
        if tag is not None:
            name = tag[1]
            error = f"its tag takes no attributes; what it is given is written between <{name}> and </{name}>"
            return ToolCall(name, {}, tag.start(), tag.end(), error)
        for found in _JSON_OUTSIDE.finditer(text):
            if found[1] in self._tools:
                error = f"a call in JSON must stand between {CALL_OPEN} and {CALL_CLOSE}"
                return ToolCall(found[1], {}, found.start(), len(text), error)
        return None

    def _misspelt(self, text: str) -> ToolCall | None:
        """Return an element whose tag was surely meant for a tool, and is none."""
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
                    return ToolCall(name, {}, tag.start(), end + len(closing), _unknown(name, self._tools))
        return None


class _Read(NamedTuple):
    """What was read between two tags: a value, or what is wrong with it."""

    value: Any
    problem: str | None = None


def json_call(action: str, tools: Mapping[str, Tool]) -> ToolCall | None:
    """Return the first ``<tool_call>{"name": …, "arguments": …}</tool_call>`` of a response.

    A call that is not complete, no valid JSON, or of no tool has an ``error``. Read as well are ``parameters`` in place
    of ``arguments``, arguments that are JSON in a string, a comma too many, and the form of gem-llm,
    ``<tool_call><tool_name>…</tool_name><arguments>{…}</arguments></tool_call>``.
    """
    start = action.find(CALL_OPEN)
    if start < 0:
        return None
    read, stop = _content(action, start + len(CALL_OPEN))
    if stop < 0:
        return ToolCall("", start=start, error=f"{CALL_OPEN} is never closed by {CALL_CLOSE}")
    if read.problem is not None:
        problem = f"between {CALL_OPEN} and {CALL_CLOSE} is no valid JSON: {read.problem}"
        return ToolCall("", start=start, end=stop, error=problem)
    content = read.value
    if isinstance(content, dict) and isinstance(content.get("function"), dict):
        content = content["function"]  # as the chat API nests it
    name = next((content[key] for key in _NAMES if key in content), None) if isinstance(content, dict) else None
    if not isinstance(name, str):
        return ToolCall("", start=start, end=stop, error=f"a call must be an object of the form {_FORM}")
    arguments: Any = next((content[key] for key in _ARGUMENTS if key in content), {})
    return _called(name, arguments, tools, start, stop)


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


def _called(name: str, arguments: Any, tools: Mapping[str, Tool], start: int, stop: int) -> ToolCall:
    """Return a call in the text, its arguments being an object, nothing, or a string that holds one or is the text."""
    tool, error = tools.get(name), None
    if arguments is None:
        arguments = {}
    if isinstance(arguments, str):
        parameter = None if tool is None else tool.text_parameter
        if parameter is not None and not arguments.lstrip().startswith("{"):
            arguments = {parameter: arguments}
        else:
            arguments, problem = _loaded(arguments)
            error = None if problem is None else f"its arguments are no valid JSON: {problem}"
    error = _problem(name, {}, tools) or error or _problem(name, arguments, tools)
    return ToolCall(name[:100], {} if error else arguments, start, stop, error)


def _problem(name: str, arguments: Any, tools: Mapping[str, Tool]) -> str | None:
    if name not in tools:
        return _unknown(name, tools)
    if not isinstance(arguments, dict):
        return "its arguments must be an object of names and values"
    return None


def _unknown(name: str, tools: Mapping[str, Tool]) -> str:
    return f"no tool {name[:100]!r}.{did_you_mean(name[:100], tools)} There are: {', '.join(tools) or 'none'}"


def _content(action: str, begin: int) -> tuple[_Read, int]:
    """Return what a JSON call holds, and where it ends; -1 where it does not."""
    first = _SPACE.match(action, begin)
    try:
        # As far as the JSON goes, since a string in it may hold the closing tag.
        value, end = _DECODER.raw_decode(action, first.end() if first else begin)
    except (ValueError, RecursionError):
        end = -1
    else:
        closing = _END_OF_CALL.match(action, end)
        if closing is not None:
            return (_Read(None, "it is nested too deeply") if is_deep(value) else _Read(value)), closing.end()
    end = action.find(CALL_CLOSE, begin)
    if end < 0:
        return _Read(None), -1
    content = action[begin:end]
    elements = _ELEMENTS.fullmatch(content)
    read = _of_elements(elements[1], elements[2]) if elements else _loaded(content)
    return read, end + len(CALL_CLOSE)


def _of_elements(name: str, rest: str) -> _Read:
    opening, closing = "<arguments>", "</arguments>"
    start, end = rest.find(opening), rest.rfind(closing)
    if start >= 0 and end > start:
        arguments = _loaded(rest[start + len(opening) : end].strip() or "{}")
        return _Read({"name": name.strip(), "arguments": arguments.value}, arguments.problem)
    if rest.strip():
        return _Read(None, f"behind <tool_name> must stand {opening}{{…}}{closing}")
    return _Read({"name": name.strip()})


def _object_in_tag(text: str, tool: Tool) -> ToolCall | None:
    """Return a call of a tool without a text form that is written as a tag all the same, around its arguments."""
    opening, closing = f"<{tool.name}>", f"</{tool.name}>"
    start = text.find(opening)
    if start < 0:
        return None
    content = start + len(opening)
    end = text.find(closing, content)
    if end < 0:
        return ToolCall(tool.name, start=start, error=f"{opening} is never closed by {closing}")
    arguments, problem = _loaded(text[content:end].strip() or "{}")
    error = None
    if problem is not None or not isinstance(arguments, dict):
        error = f"between {opening} and {closing} must stand its arguments as a JSON object"
    return ToolCall(tool.name, {} if error else arguments, start, end + len(closing), error)


def _loaded(text: str) -> _Read:
    try:
        try:
            content = _DECODER.decode(text)
        except ValueError:
            mended = _STRING_OR_LAST_COMMA.sub(lambda found: "" if found[0] == "," else found[0], text)
            if len(mended) == len(text):
                raise
            content = _DECODER.decode(mended)
    except RecursionError:
        return _Read(None, "it is nested too deeply")
    except ValueError as error:
        return _Read(None, str(error)[:200])
    return _Read(None, "it is nested too deeply") if is_deep(content) else _Read(content)


def _finite_number(text: str) -> float:
    # Python reads NaN and 1e999, which no other reader of the recorded arguments would take.
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:20]} is no finite number")
    return number


# Not strict: a program of several lines may stand in a string with its line breaks as they are.
_DECODER = json.JSONDecoder(strict=False, parse_float=_finite_number, parse_constant=_finite_number)


def _thinking(action: str, tag: str | None) -> tuple[list[tuple[int, int]], bool]:
    """Return the closed thinking blocks, and whether the first was opened before the response, as templates do."""
    if tag is None:
        return [], False
    opening, closing = f"<{tag}>", f"</{tag}>"
    end = action.find(closing)
    if end < 0:
        return [], False
    start = action.find(opening)
    opened_before = not 0 <= start < end
    spans = [(0 if opened_before else start, end + len(closing))]
    while True:
        start = action.find(opening, spans[-1][1])
        end = action.find(closing, start) if start >= 0 else -1
        if end < 0:
            return spans, opened_before
        spans.append((start, end + len(closing)))


def _elements(text: str, tag: str) -> Iterator[tuple[int, int]]:
    """Yield where the elements of a tag begin and end, each from the last opening tag before its end."""
    opening, closing = f"<{tag}>", f"</{tag}>"
    behind = 0
    while (end := text.find(closing, behind)) >= 0:
        start = text.rfind(opening, behind, end)
        behind = end + len(closing)
        if start >= 0:
            yield start, behind


def _blanked(action: str, spans: Collection[tuple[int, int]]) -> str:
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
    """Tell whether a name was meant: the case apart, one letter too many, missing or wrong, or two exchanged."""
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
