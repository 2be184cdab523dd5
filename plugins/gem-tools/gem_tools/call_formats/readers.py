"""What stands behind the mark of a call, or is a call without any mark.

Three kinds of body: JSON that names the tool, or stands behind its name; a call in Python; and elements, one for each
argument. The values of elements stand as they are, without any escape. So a value ends at a closing tag that is
followed by what may follow one, and not at the first, which a program may print; and just one line break is taken off
each end.
"""

from __future__ import annotations

import contextlib
import re
from typing import Any

from gem_core.tools import ToolCall
from gem_tools.call_formats.found import ParsedCall, Parser, Tools, closed, reads, tool_call, tool_taking
from gem_tools.call_formats.values import RawText, arguments_at, loaded, value_at

NAMES = ("name", "tool_name", "function", "tool", "action")
ARGUMENTS = ("arguments", "parameters", "args", "input", "tool_input", "action_input")
_FORM = '{"name": "…", "arguments": {…}}'

# Marks that may stand between the first and the body.
_MARKS = re.compile(
    r"(?:\s|<\|tool_calls?_section_begin\|>|<\|tool_call_begin\|>|<｜tool▁calls?▁begin｜>|<｜tool_calls?_begin｜>"
    r"|function<｜tool_sep｜>|<(?:longcat_)?tool_call(?::\w+)?>|\[TOOL_CALLS\]|```(?:json)?(?=\s*+[\[{]))*"
)
_LIST = re.compile(r"\s*+\[\s*+(?=\{)")
_PYTHON = re.compile(r"\s*+(?:\[\s*+)?([A-Za-z_][\w-]{0,100}+(?:\.[A-Za-z_][\w-]{0,100}+){0,5})\s*+(?=\()")
_NAMED = re.compile(
    r"(?:call:|function<｜tool▁sep｜>(?=\w))?([\w.:/-]{1,200}+)(?:\[CALL_ID\][\w-]{1,100}+)?\s*+"
    r"(?:\[ARGS\]|<｜tool▁sep｜>|<\|tool_call_argument_begin\|>|<tool_sep(?::\w+)?>)?(?:\s|\\n)*(?:```(?:json)?\s*+)?"
)
_FENCE_END = re.compile(r"(?:\s*+```)?")

# Some write a name before each tag, as in <steptml:invoke …>, or a mark.
_MARK = r"(?:[A-Za-z]\w{0,20}+:|｜DSML｜)?"
_NAME = r"""["']?([^\s"'<>/=]{1,200}+)["']?"""
_FUNCTION = re.compile(rf"<{_MARK}(?:function|invoke)(?:=|\s+name\s*=\s*){_NAME}\s*+>\s*+")
_FUNCTION_END = re.compile(rf"(?:\s*+</{_MARK}(?:function|invoke)>)?")
_PARAMETER = re.compile(
    rf'\s*+<{_MARK}parameter(?:=|\s+name\s*=\s*){_NAME}(?:\s+string\s*=\s*["\']?(true|false)["\']?)?\s*+>'
)
# A value ends at the closing tag that the next element follows; or, if models leave that out, where a parameter begins
# a line or another call follows. Only a value with none of these ends at the end of the call, which it may hold.
_VALUE_END = re.compile(
    rf"</{_MARK}parameter>(?=\s*+(?:<{_MARK}parameter[=\s]|</{_MARK}(?:function|invoke|tool_call)|<\||\Z))"
    rf"|(?<=\n)(?=<parameter=)|(?=</{_MARK}(?:function|invoke)>\s*+(?:</{_MARK}(?:tool_calls?|function_calls)>\s*+)?"
    rf"(?:<[|｜]|<{_MARK}(?:tool_calls?>|function_calls>|function=|invoke\s)))"
)
_CALL_END = re.compile(rf"""(?=</{_MARK}(?:function|invoke)>(?!["'`\\),;]))""")

# Hunyuan may write a suffix into each tag, LongCat a prefix, and GLM a backslash and an n between two.
_BETWEEN = r"(?:\s|\\n)*"
_KEY = re.compile(
    rf"{_BETWEEN}<(?:longcat_)?arg_key(?::\w+)?>\s*+([^<]{{1,200}}?)\s*+</(?:longcat_)?arg_key(?::\w+)?>"
    rf"{_BETWEEN}<(?:longcat_)?arg_value(?::\w+)?>"
)
_KEYED_END = re.compile(
    rf"</(?:longcat_)?arg_value(?::\w+)?>(?={_BETWEEN}(?:<(?:longcat_)?arg_key|</?(?:longcat_)?tool_call|\Z))"
)
_TOOL_NAME = re.compile(r"\s*+<tool_name>([^<]{0,200})</tool_name>\s*+<(?:arguments|parameters)>\s*+")
_ARGUMENTS_END = re.compile(r"(?:\s*+</(?:arguments|parameters)>)?")

_HEADING = re.compile(
    r"Action:[\s*`\[]*+([\w.-]{1,100}+)[ \t*`\]]*+\n[\s*#]*+Action Input:[* ]*+(?:\s*+```(?:json)?\s*+(?=[\[{]))?"
)
_RECIPIENT = re.compile(
    r"([\w.:-]{1,200}+)(?:\s|<\|constrain\|>|<\|channel\|>|\b(?:json|code|text|commentary|analysis)\b)*(<\|message\|>)?"
)


# JSON and Python.


def json_call(text: str, at: int) -> ParsedCall:
    """Read the object that names a tool at a place, or the first of a list of them.

    Only this one value is decoded, so that it may hold what looks like its end, and what follows may be anything.
    """
    inside = _LIST.match(text, at)
    try:
        value, end = value_at(text, inside.end() if inside else at)
    except ValueError as error:
        return ParsedCall("", None, 0, problem=f"is no valid JSON: {error}"[:220])
    if isinstance(value, dict) and isinstance(value.get("function"), dict):
        value = value["function"]  # as the chat API nests it
    name = next((value[key] for key in NAMES if key in value), None) if isinstance(value, dict) else None
    if not isinstance(name, str):
        return ParsedCall("", None, end, problem=f"a call must be an object of the form {_FORM}")
    return ParsedCall(name, next((value[key] for key in ARGUMENTS if key in value), None), end)


def python_call(text: str, at: int) -> ParsedCall | None:
    """Read the call in Python at a place, or the first of a list of them; its arguments are literals."""
    opening = _PYTHON.match(text, at)
    if opening is None:
        return None
    try:
        given, end = arguments_at(text, opening.end())
    except ValueError as error:
        return ParsedCall(opening[1], None, 0, problem=f"its arguments are no literals of Python: {error}"[:220])
    return ParsedCall(opening[1], given, end)


def _object(name: str, text: str, at: int, behind: re.Pattern[str]) -> ParsedCall:
    """Read the arguments of a tool that was named before them, and what closes them."""
    try:
        given, end = value_at(text, at)
    except ValueError as error:
        return ParsedCall(name, None, 0, problem=f"its arguments are no valid JSON: {error}"[:250])
    found = behind.match(text, end)
    return ParsedCall(name, given, found.end() if found else end)


def body(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Read a call after a mark that many families use; the next character decides which form it is."""
    marks = _MARKS.match(text, at)
    at = marks.end() if marks else at
    first = text[at : at + 1]
    if first == "<":
        named = _TOOL_NAME.match(text, at)  # gem-llm
        if named is not None:
            return _object(named[1].strip(), text, named.end(), _ARGUMENTS_END)
        return function(text, at, at, tools) or json_call(text, at)
    if first == "[":
        return python_call(text, at) or json_call(text, at)
    if first in ("", "{", '"'):
        return json_call(text, at)
    return _named(text, at) or json_call(text, at)


def _named(text: str, at: int) -> ParsedCall | None:
    """Read a call that begins with the tool's name, as Mistral, DeepSeek, Kimi, GLM, Gemma and OLMo write it."""
    opening = _NAMED.match(text, at)
    if opening is None:
        return None
    name, at = opening[1], opening.end()
    if text.startswith("{", at):
        return _object(name, text, at, _FENCE_END)
    if text.startswith("(", at):
        return python_call(text, opening.start(1))
    if text.startswith("</tool_call", at):
        return ParsedCall(name, {}, at)
    given: dict[str, Any] = {}
    while key := _KEY.match(text, at):
        ending = _KEYED_END.search(text, key.end())
        given[key[1]] = RawText(_without_line_breaks(text[key.end() : ending.start() if ending else len(text)]))
        if ending is None:
            return ParsedCall(name, given, len(text), cut=True)
        at = ending.end()
    return ParsedCall(name, given, at) if given else None


# Elements.


def function(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """``<function=NAME>`` or ``<invoke name="NAME">``, around JSON or an element ``<parameter…>`` for each argument."""
    opening = _FUNCTION.match(text, start)
    if opening is None:
        return None
    at = opening.end()
    if text.startswith("{", at):
        return _object(opening[1], text, at, _FUNCTION_END)
    given: dict[str, Any] = {}
    while parameter := _PARAMETER.match(text, at):
        ending = _VALUE_END.search(text, parameter.end()) or _CALL_END.search(text, parameter.end())
        content = _without_line_breaks(text[parameter.end() : ending.start() if ending else len(text)])
        given[parameter[1]] = content if parameter[2] == "true" else RawText(content)
        if parameter[2] == "false":
            with contextlib.suppress(ValueError):
                given[parameter[1]] = loaded(content)
        if ending is None:
            return ParsedCall(opening[1], given, len(text), cut=True)
        at = ending.end()
    end = _FUNCTION_END.match(text, at)
    if not given and (end is None or end.end() == at):
        return ParsedCall(opening[1], None, 0, problem="stand neither JSON nor parameters")
    return ParsedCall(opening[1], given, end.end() if end else at)


def _without_line_breaks(content: str) -> str:
    """Take one line break off each end, and no more: the first line of a program may be indented."""
    content = content.removeprefix("\r\n") if content.startswith("\r") else content.removeprefix("\n")
    return content.removesuffix("\n").removesuffix("\r") if content.endswith("\n") else content


# Code, queries and messages.


def between(closing: str, takes: str) -> Parser:
    """Return a reader of what stands between two marks and is given to the tool that takes it."""

    def read(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
        end = text.find(closing, at)
        if end >= 0:
            return ParsedCall("", _text(text[at:end]), end + len(closing), takes)
        if not text[at:].strip() or text[start:at] in text[at:]:
            return ParsedCall("", None, 0, problem=f"stands no {closing}")
        return ParsedCall("", _text(text[at:]), len(text), takes, cut=True)

    return read


def code_lines(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Smolagents: ``<code>``, which is also a tag of HTML, so that the element must end its line."""
    end = text.find("</code>", at)
    ends_line = end >= 0 and not text[end + len("</code>") :].partition("\n")[0].strip()
    if tool_taking("code", tools) is None or not (ends_line or (end < 0 and _begins_line(text, start))):
        return None
    call = between("</code>", "code")(text, start, at, tools)
    return None if call is None or call.problem is not None else call


def harmony(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """gpt-oss: a message to a recipient, as JSON or, for a built-in tool, code as it is."""
    header = _RECIPIENT.match(text, at)
    if header is None or header[1] == "assistant" or text[max(0, start - 1) : start] not in ("", " ", "\n", ">"):
        return None
    of_function = header[1].startswith("functions.")
    if not header[2] and not (of_function and text.startswith("{", header.end())):
        return None
    stop = re.compile(r"<\|(?:call|end|return|start)\|>").search(text, header.end())
    return (
        _json_or_text(header[1], text, header.end(), stop)
        if of_function
        else _as_text(header[1], text, header.end(), stop)
    )


def react(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """ReAct: ``Action: NAME`` and ``Action Input: …``, up to the observation."""
    heading = _HEADING.match(text.replace("**", "  "), start)
    if heading is None or text[text.rfind("\n", 0, start) + 1 : start].strip(" \t*#"):
        return None
    stop = re.compile(r"\n[ \t*#]*+Observation|\Z").search(text, heading.end())
    return _json_or_text(heading[1], text, heading.end(), stop)


def _json_or_text(name: str, text: str, at: int, stop: re.Match[str] | None) -> ParsedCall:
    """Read an object of arguments, or else the text up to the mark that ends it."""
    if text[at:].lstrip().startswith("{"):
        try:
            given, end = value_at(text, at)
        except ValueError:
            given, end = None, at
        if isinstance(given, dict):
            return ParsedCall(name, given, end)
    return _as_text(name, text, at, stop)


def _as_text(name: str, text: str, at: int, stop: re.Match[str] | None) -> ParsedCall:
    end = stop.start() if stop else len(text)
    return ParsedCall(name, _text(text[at:end]), end)


def _text(content: str) -> RawText:
    """Return text for a parameter: blanks around a single line are no part of it, an indentation of several is."""
    content = content.strip("\r\n")
    return RawText(content if "\n" in content.strip() else content.strip())


def _begins_line(text: str, at: int) -> bool:
    return not text[text.rfind("\n", 0, at) + 1 : at].strip()


# Calls without any mark. Such text may also be an answer, so it counts as a call only if it names a tool, begins a
# line, and nothing follows it but another call.

_BEFORE = re.compile(r"\s*+(?:```\w*+\s*+)?(?:\[\s*+)?")
_BEHIND = re.compile(r"(?:\s|[,;\]]|```)*")


def _alone(text: str, start: int, end: int) -> bool:
    if not _BEFORE.fullmatch(text[text.rfind("\n", 0, start) + 1 : start]):
        return False
    found = _BEHIND.match(text, closed(text, end))
    end = closed(text, found.end() if found else end)
    return end >= len(text) or text[end] in "{[<" or re.compile(r"[\w-]{1,100}+\(").match(text, end) is not None


def read_bare_json(opening: re.Match[str], tools: Tools) -> ToolCall | None:
    """Read an object that describes a call: Llama 3, xLAM. One that begins as a call and cannot be read is told."""
    text, start = opening.string, opening.start()
    given = "|".join(ARGUMENTS)
    call = json_call(text, start)
    if call.problem is not None:
        names = "|".join(map(re.escape, tools))
        begins = re.compile(
            rf"""\{{\s*+["'](?:{"|".join(NAMES)})["']\s*+:\s*+["'](?:{names})["']\s*+,\s*+["'](?:{given})["']"""
        )
        if call.end or not tools or not begins.match(text, start):
            return None
        return tool_call(call._replace(end=len(text)), start, tools)
    is_call = call.name in tools or re.compile(r"""\{\s*+["']type["']\s*+:\s*+["']function["']""").match(text, start)
    if not is_call or call.arguments is None or not _alone(text, start, call.end):
        return None
    return tool_call(call._replace(end=closed(text, call.end)), start, tools)


def read_bare_python(opening: re.Match[str], tools: Tools) -> ToolCall | None:
    """Read a list of calls in Python, or a response that is one call: Llama 4, ToolACE, Gemma."""
    text, start = opening.string, opening.start()
    call = python_call(text, start)
    if call is None or call.name not in tools:
        return None
    if not opening[0].startswith("["):
        if call.problem is not None or text[call.end :].strip():
            return None
    elif not _alone(text, start, call.end or len(text)):
        return None
    return tool_call(call._replace(end=closed(text, call.end)), start, tools)


read_body = reads(body)
read_function = reads(function)
read_invoke = reads(lambda text, start, at, tools: function(text, start, at, tools) or body(text, start, at, tools))
read_functools = reads(
    lambda text, start, at, tools: None if (call := json_call(text, at - 1)).problem else call, sure=False
)
read_message = reads(harmony, sure=False)
read_react = reads(react, sure=False)
read_search_query = reads(between("<|end_search_query|>", "query"))
read_query = reads(between("<|end_of_query|>", "query"))
read_execute = reads(between("</execute>", "code"))
read_code_lines = reads(code_lines, sure=False)
