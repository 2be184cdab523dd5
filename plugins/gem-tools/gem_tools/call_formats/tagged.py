"""Calls written as elements, one for each argument: Qwen3-Coder, Seed-OSS, MiniMax M2, DeepSeek V3.2, Step3, GLM.

Their values stand as they are, without any escape. So a value ends at a closing tag that is followed by what may follow
one, and not at the first, which a program may print; and just one line break is taken off each end.
"""

from __future__ import annotations

import re
from typing import Any

from gem_tools.call_formats.found import NO_JSON, ParsedCall, Tools, reads
from gem_tools.call_formats.values import RawText, loaded, skip_blanks, typed, value_at

# Some write a name before each tag, as in <steptml:invoke …>, or a mark.
_MARK = r"(?:[A-Za-z]\w{0,20}+:|｜DSML｜)?"
_NAME = r"""["']?([^\s"'<>/=]{1,200}+)["']?"""
_FUNCTION = re.compile(rf"<{_MARK}(?:function|invoke)(?:=|\s+name\s*=\s*){_NAME}\s*+>")
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
_FUNCTION_END = re.compile(rf"""\s*+</{_MARK}(?:function|invoke)>""")
_TEXT_END = re.compile(rf"""</{_MARK}(?:function|invoke)>(?!["'`\\),;])""")

# Hunyuan may write a suffix into each tag, LongCat a prefix, and GLM a backslash and an n between two.
_BETWEEN = r"(?:\s|\\n)*"
_KEY = re.compile(
    rf"{_BETWEEN}<(?:longcat_)?arg_key(?::\w+)?>\s*+([^<]{{1,200}}?)\s*+</(?:longcat_)?arg_key(?::\w+)?>"
    rf"{_BETWEEN}<(?:longcat_)?arg_value(?::\w+)?>"
)
_KEYED_END = re.compile(
    rf"</(?:longcat_)?arg_value(?::\w+)?>(?={_BETWEEN}(?:<(?:longcat_)?arg_key|</?(?:longcat_)?tool_call|\Z))"
)

_TOOL_NAME = re.compile(r"\s*+<tool_name>([^<]{0,200})</tool_name>\s*+(<(?:arguments|parameters)>\s*+)?")
_ELEMENT = re.compile(r"\s*+<(\w{1,100})>")
_ELEMENTS_END = re.compile(r"\s*+</(?:arguments|parameters)>")


def function(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """``<function=NAME>`` or ``<invoke name="NAME">``, around JSON, elements ``<parameter…>``, or the text alone."""
    opening = _FUNCTION.match(text, start)
    if opening is None:
        return None
    at = skip_blanks(text, opening.end())
    if text.startswith("{", at):
        try:
            given, end = value_at(text, at)
        except ValueError as error:
            return ParsedCall(opening[1], None, 0, problem=f"its arguments are no valid JSON: {error}"[:250])
        return ParsedCall(opening[1], given, _behind(_FUNCTION_END, text, end))
    if _PARAMETER.match(text, at) is None and not _FUNCTION_END.match(text, at):
        ending = _TEXT_END.search(text, at)
        content = RawText(text[opening.end() : ending.start() if ending else len(text)])
        return ParsedCall(opening[1], content, ending.end() if ending else len(text), cut=ending is None)
    return _parameters(opening[1], text, at)


def _parameters(name: str, text: str, at: int) -> ParsedCall:
    given: dict[str, Any] = {}
    while parameter := _PARAMETER.match(text, at):
        ending = _VALUE_END.search(text, parameter.end()) or _CALL_END.search(text, parameter.end())
        if ending is None:
            given[parameter[1]] = _value(text[parameter.end() :], parameter[2])
            return ParsedCall(name, given, len(text), cut=True)
        given[parameter[1]] = _value(text[parameter.end() : ending.start()], parameter[2])
        at = ending.end()
    return ParsedCall(name, given, _behind(_FUNCTION_END, text, at))


def _value(content: str, is_text: str | None) -> Any:
    content = _without_line_breaks(content)
    if is_text == "true":
        return content
    read = loaded(content) if is_text == "false" else None
    return RawText(content) if read is None or read.problem else read.value


def keyed(name: str, text: str, at: int) -> ParsedCall | None:
    """GLM and Hunyuan 3: after the name, ``<arg_key>…</arg_key><arg_value>…</arg_value>`` for each argument."""
    given: dict[str, Any] = {}
    while key := _KEY.match(text, at):
        ending = _KEYED_END.search(text, key.end())
        if ending is None:
            given[key[1]] = RawText(_without_line_breaks(text[key.end() :]))
            return ParsedCall(name, given, len(text), cut=True)
        given[key[1]] = RawText(_without_line_breaks(text[key.end() : ending.start()]))
        at = ending.end()
    return ParsedCall(name, given, at) if given else None


def elements(text: str, at: int) -> ParsedCall | None:
    """``<tool_name>`` and ``<arguments>``, around JSON (gem-llm) or an element for each (an older kind of invoke)."""
    opening = _TOOL_NAME.match(text, at)
    if opening is None:
        return None
    name, at = opening[1].strip(), opening.end()
    if opening[2] is None:
        behind = re.compile(r"</|\Z").match(text, at)
        problem = None if behind else "behind <tool_name> must stand <arguments>{…}</arguments>"
        return ParsedCall(name if behind else "", {}, at, problem=problem)
    if text.startswith("{", at):
        try:
            given, end = value_at(text, at)
        except ValueError as error:
            return ParsedCall("", None, 0, problem=f"{NO_JSON}: {error}"[:220])
        return ParsedCall(name, given, _behind(_ELEMENTS_END, text, end))
    given = {}
    while element := _ELEMENT.match(text, at):
        closing = f"</{element[1]}>"
        structural = re.compile(rf"{closing}(?=\s*+(?:<\w|</(?:arguments|parameters)>))").search(text, element.end())
        if structural is None:
            return ParsedCall(name, None, 0, problem=f"<{element[1]}> is never closed by {closing}")
        given[element[1]] = RawText(_without_line_breaks(text[element.end() : structural.start()]))
        at = structural.end()
    return ParsedCall(name, given, _behind(_ELEMENTS_END, text, at))


def _behind(pattern: re.Pattern[str], text: str, at: int) -> int:
    found = pattern.match(text, at)
    return found.end() if found else at


def _without_line_breaks(content: str) -> str:
    """Take one line break off each end, and no more: the first line of a program may be indented."""
    content = content.removeprefix("\r\n") if content.startswith("\r") else content.removeprefix("\n")
    return content.removesuffix("\n").removesuffix("\r") if content.endswith("\n") else content


# MiniMax M3 writes a mark before each tag, so that nothing in a value can be taken for one.
_M3 = "]<]minimax[>["
_M3_TAG = re.compile(rf"{re.escape(_M3)}<(/?)([\w.-]{{1,200}}+)>")
_M3_INVOKE = re.compile(rf"""\s*+{re.escape(_M3)}<invoke\s+name\s*=\s*{_NAME}\s*+>""")
_MOST_DEPTH = 50


def minimax_m3(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """MiniMax M3: an element for each parameter, in which lists are elements ``item`` and objects one for each key."""
    opening = _M3_INVOKE.match(text, start) or _M3_INVOKE.match(text, at)
    if opening is None:
        return None
    given: dict[str, Any] = {}
    open_elements: list[tuple[str, int, list[tuple[str, Any]]]] = []
    for tag in _M3_TAG.finditer(text, opening.end()):
        name = tag[2]
        if not tag[1]:
            if len(open_elements) == _MOST_DEPTH:
                return ParsedCall(opening[1], None, 0, problem="its arguments are nested too deeply")
            open_elements.append((name, tag.end(), []))
        elif not open_elements and name in ("invoke", "tool_call"):
            return ParsedCall(opening[1], _by_schema(given, opening[1], tools), tag.end())
        elif open_elements and open_elements[-1][0] == name:
            _, begin, children = open_elements.pop()
            value: Any = RawText(_without_line_breaks(text[begin : tag.start()]))
            if children:
                is_list = all(child == "item" for child, _ in children)
                value = [child for _, child in children] if is_list else dict(children)
            if open_elements:
                open_elements[-1][2].append((name, value))
            else:
                given[name] = value
    if open_elements:  # cut in a value, which is text as far as anybody knows
        name, begin, _ = open_elements[0]
        given[name] = RawText(_without_line_breaks(text[begin:]))
    return ParsedCall(opening[1], given, len(text), cut=True)


def _by_schema(given: dict[str, Any], name: str, tools: Tools) -> dict[str, Any]:
    schema = tools[name].parameters_schema() if name in tools else {}
    definitions: dict[str, Any] = {key: schema[key] for key in ("$defs", "definitions") if key in schema}

    def converted(value: Any, described: Any) -> Any:
        described = described if isinstance(described, dict) else {}
        if isinstance(value, list):
            return [converted(item, described.get("items")) for item in value]
        if isinstance(value, dict):
            inner = described.get("properties")
            return {
                key: converted(item, inner.get(key) if isinstance(inner, dict) else None) for key, item in value.items()
            }
        return typed(value, "value", {"properties": {"value": described}, **definitions})

    properties = schema.get("properties")
    return {
        key: converted(value, properties.get(key) if isinstance(properties, dict) else None)
        for key, value in given.items()
    }


def own_tag(text: str, start: int, at: int, tools: Tools) -> ParsedCall | None:
    """Read the tag of a tool that takes no text, around its arguments as Python, or JSON with a slip."""
    name = text[start + 1 : at].rstrip().removesuffix(">")
    tool = tools.get(name)
    if tool is None or tool.text_parameter is not None:
        return None
    try:
        given, end = value_at(text, at)
    except ValueError:
        return None
    closing = re.compile(rf"\s*+</{re.escape(name)}>").match(text, end)
    return ParsedCall(name, given, closing.end()) if closing else None


read_function = reads(function)
read_minimax_m3 = reads(minimax_m3)
read_own_tag = reads(own_tag, sure=False)
