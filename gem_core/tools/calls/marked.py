"""Readers of calls that begin with a mark: code and queries, messages to recipients, ReAct."""

from __future__ import annotations

import re
from collections.abc import Callable

from gem_core.parsing import extract_code_blocks, unclosed_code_block
from gem_core.tools.calls.found import ParsedCall, Tools, tool_taking
from gem_core.tools.calls.json_calls import NAMES, fenced_list, json_call_at
from gem_core.tools.calls.pythonic import pythonic
from gem_core.tools.calls.tagged import elements, function, keyed
from gem_core.tools.calls.values import Raw, value_at

Reader = Callable[[str, int, int, Tools], ParsedCall | None]
"""Reads a call, given the response, where the opening mark begins and ends, and the tools; None where there is none."""

# Marks that may stand between the opening mark and the call.
_MARKS = re.compile(
    r"(?:\s|<\|tool_calls?_section_begin\|>|<\|tool_call_begin\|>|<｜tool▁calls?▁begin｜>|<｜tool_calls?_begin｜>"
    r"|function<｜tool_sep｜>|<\|plugin\|>|<tool_call(?::\w+)?>|<invoke>|\[TOOL_CALLS\]|```(?:json)?(?=\s*+[\[{]))*"
)
_NAMED = re.compile(
    r"(?:call:|function<｜tool▁sep｜>(?=\w))?([\w.:/-]{1,200}+)(?:\[CALL_ID\][\w-]{1,100}+)?\s*+"
    r"(?:\[ARGS\]|<｜tool▁sep｜>|<\|tool_call_argument_begin\|>|<tool_sep(?::\w+)?>)?(?:\s|\\n)*(```(?:json)?\s*+)?"
)
_FENCE_END = re.compile(r"\s*+```")
_JSON_FENCE = re.compile(r"\s*+```(?:json)?\s*+(?=[\[{])")
_NUMBERED = re.compile(r"(?: ?\d{1,3}+)?:")
_HEADING = re.compile(r"(?<![^\s*#])(?:Action(?: ?\d{1,3}+)?|✿FUNCTION✿):")
_INPUT = re.compile(r"(?: ?\d{1,3}+(?=:))?[*: ]{0,3}+")
_BRACKET = re.compile(r"[\s*]*+([\w-]{1,100}+)\[(.+)\]\s*+")


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


def suffixed(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Hunyuan 3: each tag may have a suffix, as in ``<tool_calls:opensource>``."""
    end = text.find(">", at, at + 40)
    return body(text, start, end + 1, tools) if end >= 0 else None


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


def between(closing: str, takes: str, *, whole_lines: bool = False) -> Reader:
    """Return a reader of what stands between two marks and is given to the tool that takes it.

    Args:
        closing: The mark at the end.
        takes: The parameter.
        whole_lines: Whether the element must end its line, where the tag is also one of HTML's.
    """

    def read(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
        if whole_lines and tool_taking(takes, tools) is None:
            return None
        end = text.find(closing, at)
        if whole_lines and not _ends_line(text, end + len(closing)) and (end >= 0 or not _begins_line(text, start)):
            return None
        if end >= 0:
            return ParsedCall("", _text(text[at:end]), end + len(closing), takes)
        if not text[at:].strip() or text[start:at] in text[at:]:
            return ParsedCall("", None, 0, problem=f"{text[start:at]} is never closed by {closing}")
        return ParsedCall("", _text(text[at:]), len(text), takes, cut=True)

    return read


def python_tag(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Llama: code as it is, a call in JSON, or a built-in tool as ``brave_search.call(query="…")``."""
    if re.compile(rf'\s*+\{{\s*+["\'](?:type|{"|".join(NAMES)})["\']').match(text, at):
        return json_call_at(text, at)
    written = pythonic(text, at)
    if written is not None and written.problem is None:
        name = written.name.removesuffix(".call")
        if name in tools:
            return written._replace(name=name)
        if name != written.name and isinstance(written.arguments, dict) and len(written.arguments) == 1:
            takes, value = next(iter(written.arguments.items()))
            return ParsedCall("", value, written.end, takes=takes)
    return _code(text, at, re.compile(r"<\|(?:eom_id|eot_id|eot|python_end)\|>").search(text, at))


def plugin(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """InternLM: a call in JSON, or code for its interpreter."""
    interpreter = re.compile(r"\s*+<\|interpreter\|>").match(text, at)
    if interpreter is None:
        return body(text, start, at, tools)
    return _code(text, interpreter.end(), re.compile(r"<\|action_end\|>").search(text, interpreter.end()))


def code_fence(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Gemma: a block ``tool_code``, around a call in Python or code as it is."""
    block = next(iter(extract_code_blocks(text[start:], "tool_code")), None)
    unclosed = block is None
    block = block or unclosed_code_block(text[start:], "tool_code")
    if block is None or block.start > 0:
        return None
    end = len(text) if unclosed else start + block.end
    written = pythonic(block.code, 0)
    if written is not None and written.problem is None and written.name in tools:
        return written._replace(end=end, cut=unclosed)
    return ParsedCall("", _text(block.code), end, takes="code", cut=unclosed)


def harmony(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """gpt-oss: a message to a recipient, as JSON or, for a built-in tool, code as it is."""
    header = re.compile(
        r"([\w.:-]{1,200}+)(?:\s|<\|constrain\|>|<\|channel\|>|\b(?:json|code|text|commentary|analysis)\b)*(<\|message\|>)?"
    ).match(text, at)
    if header is None or header[1] == "assistant" or text[max(0, start - 1) : start] not in ("", " ", "\n", ">"):
        return None
    if not header[2] and not (header[1].startswith("functions.") and text.startswith("{", header.end())):
        return None
    stop = re.compile(r"<\|(?:call|end|return|start)\|>").search(text, header.end())
    if not header[1].startswith("functions."):
        return _as_text(header[1], text, header.end(), stop)
    return _json_or_text(header[1], text, header.end(), stop)


def functionary(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Functionary v2: the recipient on a line before ``<|content|>``; ``all`` is the user."""
    name = text[max(0, start - 300) : start].rstrip().rpartition("\n")[2].rpartition("<|recipient|>")[2].strip()
    if not name or name == "all":
        return None
    return _json_or_text(name, text, at, re.compile(r"<\|(?:from|stop)\|>").search(text, at))


def functionary_v3(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Functionary v3: ``>>>`` and the recipient, on a line of its own."""
    name = text[at : at + 300].partition("\n")[0].strip()
    if name not in tools:
        return None
    content = text.index("\n", at) + 1 if "\n" in text[at : at + 300] else len(text)
    return _json_or_text(name, text, content, re.compile(r"\n?>>>|<\|eot_id\|>").search(text, content))


def action(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """What stands after ``Action:`` alone: Command-R's fenced list, or ``search[…]`` and ``search("…")`` of a tool."""
    colon = _NUMBERED.match(text, at)
    if colon is None:
        return None
    at = colon.end()
    fence = _JSON_FENCE.match(text, at)
    if fence is not None:
        return fenced_list(text, fence.end())
    line_end = text.find("\n", at)
    bracket = _BRACKET.fullmatch(text, at, line_end if line_end >= 0 else len(text))
    if bracket is not None:
        name = bracket[1] if bracket[1] in tools else bracket[1].lower()
        return ParsedCall(name, Raw(bracket[2]), bracket.end(2) + 1) if name in tools else None
    written = pythonic(text, at)
    return written if written is not None and written.problem is None and written.name in tools else None


def react(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """ReAct, and Qwen-Agent's kin: the tool on one line, its input after the next heading."""
    before = text[max(0, start - 400) : start].rstrip(" \t*#")
    heading = next(reversed([*_HEADING.finditer(before)]), None)
    name = before[heading.end() :].strip(" \t\r\n*`[]") if heading else ""
    if not name or "\n" in name or not before.endswith("\n"):
        return None
    colon = _INPUT.match(text, at)
    at = colon.end() if colon else at
    fence = _JSON_FENCE.match(text, at)
    stop = re.compile(r"\n[ \t*#]*+Observation|✿RESULT✿|\Z").search(text, at)
    return _json_or_text(name, text, fence.end() if fence else at, stop)


def _json_or_text(name: str, text: str, at: int, stop: re.Match[str] | None) -> ParsedCall:
    """Read an object of arguments, or else the text up to the mark that ends it, without quotation marks around it."""
    try:
        given, end = value_at(text, at) if re.compile(r'\s*+[{"]').match(text, at) else (None, 0)
    except ValueError:
        given, end = None, 0
    if isinstance(given, dict):
        return ParsedCall(name, given, end)
    if isinstance(given, str) and not text[end : stop.start() if stop else len(text)].strip():
        return ParsedCall(name, Raw(given), end)
    return _as_text(name, text, at, stop)


def _as_text(name: str, text: str, at: int, stop: re.Match[str] | None) -> ParsedCall:
    end = stop.start() if stop else len(text)
    return ParsedCall(name, _text(text[at:end]), end)


def _code(text: str, at: int, stop: re.Match[str] | None) -> ParsedCall:
    return _as_text("", text, at, stop)._replace(takes="code")


def _text(content: str) -> Raw:
    """Return text for a parameter: blanks around a single line are no part of it, an indentation of several is."""
    content = content.strip("\r\n")
    return Raw(content if "\n" in content.strip() else content.strip())


def _ends_line(text: str, at: int) -> bool:
    end = text.find("\n", at)
    return not text[at : end if end >= 0 else len(text)].strip()


def _begins_line(text: str, at: int) -> bool:
    return not text[text.rfind("\n", 0, at) + 1 : at].strip()
