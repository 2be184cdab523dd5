"""Calls that hold text for a tool: code, a query, or a message to a recipient."""

from __future__ import annotations

import builtins
import re

from gem_core.parsing import extract_code_blocks, unclosed_code_block
from gem_tools.call_formats.bodies import body
from gem_tools.call_formats.found import ParsedCall, Parser, Tools, if_whole, reads, tool_taking
from gem_tools.call_formats.objects import NAMES, json_call_at, pythonic
from gem_tools.call_formats.values import RawText, value_at

_JSON_FENCE = re.compile(r"\s*+```(?:json)?\s*+(?=[\[{])")
_NUMBERED = re.compile(r"(?: ?\d{1,3}+)?:")
_HEADING = re.compile(r"(?<![^\s*#])Action(?: ?\d{1,3}+)?:")
_INPUT = re.compile(r"(?: ?\d{1,3}+(?=:))?[*: ]{0,3}+")
_BRACKET = re.compile(r"[\s*]*+([\w-]{1,100}+)\[(.+)\]\s*+")


def between(closing: str, takes: str, *, whole_lines: bool = False) -> Parser:
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
    """Gemma: a block ``tool_code``, around a call in Python, or code for the tool that takes it.

    A call of a tool that cannot be read, or of one that there is not, is not run as code.
    """
    block = next(iter(extract_code_blocks(text[start:], "tool_code")), None)
    unclosed = block is None
    block = block or unclosed_code_block(text[start:], "tool_code")
    if block is None or block.start > 0 or not _begins_line(text, start):
        return None
    end = len(text) if unclosed else start + block.end
    written = pythonic(block.code, 0)
    takes_code = tool_taking("code", tools)
    if written is not None:
        alone = written.problem is None and not block.code[written.end :].strip(" \t\r\n]")
        foreign = alone and isinstance(written.arguments, dict) and not hasattr(builtins, written.name)
        other = written.name in tools and (takes_code is None or written.name != takes_code.name)
        if other or foreign or (written.name in tools and written.problem is None):
            return written._replace(end=end, cut=unclosed and written.problem is None)
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


def react_action(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """ReAct: ``Action:`` and ``Action Input:``; or, as in its paper, ``search[…]`` alone."""
    if text.startswith(" Input", at):
        return _with_input(text, start, at + len(" Input"))
    colon = _NUMBERED.match(text, at)
    if colon is None:
        return None
    at = colon.end()
    line_end = text.find("\n", at)
    bracket = _BRACKET.fullmatch(text, at, line_end if line_end >= 0 else len(text))
    if bracket is not None:
        name = bracket[1] if bracket[1] in tools else bracket[1].lower()
        return ParsedCall(name, RawText(bracket[2]), bracket.end(2) + 1) if name in tools else None
    written = pythonic(text, at)
    return written if written is not None and written.problem is None and written.name in tools else None


def _with_input(text: str, start: int, at: int) -> ParsedCall | None:
    before = text[max(0, start - 400) : start].rstrip(" \t*#")
    heading = next(reversed([*_HEADING.finditer(before)]), None)
    name = before[heading.end() :].strip(" \t\r\n*`[]") if heading else ""
    if not name or "\n" in name or not before.endswith("\n"):
        return None
    colon = _INPUT.match(text, at)
    at = colon.end() if colon else at
    fence = _JSON_FENCE.match(text, at)
    stop = re.compile(r"\n[ \t*#]*+Observation|\Z").search(text, at)
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
        return ParsedCall(name, RawText(given), end)
    return _as_text(name, text, at, stop)


def _as_text(name: str, text: str, at: int, stop: re.Match[str] | None) -> ParsedCall:
    end = stop.start() if stop else len(text)
    return ParsedCall(name, _text(text[at:end]), end)


def _code(text: str, at: int, stop: re.Match[str] | None) -> ParsedCall:
    return _as_text("", text, at, stop)._replace(takes="code")


def _text(content: str) -> RawText:
    """Return text for a parameter: blanks around a single line are no part of it, an indentation of several is."""
    content = content.strip("\r\n")
    return RawText(content if "\n" in content.strip() else content.strip())


def _ends_line(text: str, at: int) -> bool:
    end = text.find("\n", at)
    return not text[at : end if end >= 0 else len(text)].strip()


def _begins_line(text: str, at: int) -> bool:
    return not text[text.rfind("\n", 0, at) + 1 : at].strip()


read_python_tag = reads(python_tag)
read_plugin = reads(plugin)
read_code_fence = reads(code_fence, sure=False)
read_message = reads(harmony, sure=False)
read_action = reads(react_action, sure=False)
read_search_query = reads(between("<|end_search_query|>", "query"))
read_query = reads(between("<|end_of_query|>", "query"))
read_execute = reads(between("</execute>", "code"))
read_code_lines = reads(if_whole(between("</code>", "code", whole_lines=True)), sure=False)
