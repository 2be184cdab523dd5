"""Values as models write them: JSON with its slips, Python literals, and raw text that a schema gives its type."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from gem_core.tools import json_at

_TOO_DEEP = "it is nested too deeply"
_MOST_DEPTH = 99


class RawText(str):
    """Raw text of the response, not JSON; the schema of the tool decides its type."""

    __slots__ = ()


class ParseResult(NamedTuple):
    """The result of reading a text: a value, or an error."""

    value: Any
    problem: str | None = None


def loaded(text: str) -> ParseResult:
    """Return the one value that a text holds."""
    try:
        value, end = value_at(text, 0)
        if not text[end:].strip():
            return ParseResult(value)
        return ParseResult(None, f"Extra data behind {text[:end].strip()[-20:]!r}")
    except ValueError as error:
        return ParseResult(None, str(error)[:200])


def value_at(text: str, at: int) -> tuple[Any, int]:
    """Return the value that begins at a place, and the index after it: JSON, or what Python and Gemma write for it.

    Args:
        text: The response.
        at: Where the value begins, white space apart.

    Raises:
        ValueError: There is none; the message says what is wrong with it as JSON.
    """
    try:
        return json_at(text, at)
    except ValueError as problem:
        try:
            return _literal(text, at, 0)
        except ValueError:
            raise problem from None


def skip_blanks(text: str, at: int) -> int:
    """Return the index of the first character from a place on that is no white space."""
    found = _BLANKS.match(text, at)
    return found.end() if found else at


def arguments_at(text: str, at: int) -> tuple[Any, int]:
    """Return the arguments after the ``(`` of a call in Python, by name, and the index after its ``)``.

    A single argument without a name is returned as text.

    Raises:
        ValueError: They are no literals, or the call is never closed.
    """
    given: dict[str, Any] = {}
    while (token := _token(text, at))[0] != ")":
        word, end = token
        if word.isidentifier() and _token(text, end)[0] == "=":
            given[word], at = _literal(text, _token(text, end)[1], 0)
        else:
            alone, end = _literal(text, at, 0)
            if given or not isinstance(alone, str) or _token(text, end)[0] != ")":
                raise ValueError("arguments are written as name=value")
            return RawText(alone), _token(text, end)[1]
        at = _behind_comma(text, at, ")")
    return given, token[1]


def typed(value: Any, name: str, schema: Mapping[str, Any]) -> Any:
    """Return an argument that stands as raw text in the response as its parameter takes it.

    It stays text where the parameter may be text, or is not known; otherwise it is JSON or a Python literal, as far as
    it can be read.
    """
    if not isinstance(value, RawText):
        return value
    properties = schema.get("properties")
    described = properties.get(name) if isinstance(properties, Mapping) else None
    if _may_be_text(described, schema, 0):
        return str(value)
    read = loaded(value)
    return str(value) if read.problem else read.value


def _may_be_text(described: object, schema: Mapping[str, Any], depth: int) -> bool:
    """Tell whether a parameter takes text, as one of which nothing is said does."""
    if not isinstance(described, Mapping) or depth > 5:
        return True
    reference = described.get("$ref")
    if isinstance(reference, str):
        definitions = schema.get("$defs", schema.get("definitions"))
        name = reference.rpartition("/")[2]
        return _may_be_text(definitions.get(name) if isinstance(definitions, Mapping) else None, schema, depth + 1)
    kinds = described.get("type")
    if kinds is not None:
        return kinds == "string" or (isinstance(kinds, list) and "string" in kinds)
    values = [*_listed(described.get("enum")), *([described["const"]] if "const" in described else [])]
    options = [part for key in ("anyOf", "oneOf", "allOf") for part in _listed(described.get(key))]
    if not values and not options:
        return True
    return any(isinstance(value, str) for value in values) or any(
        _may_be_text(option, schema, depth + 1) for option in options
    )


def _listed(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


# Literals of Python; and of Gemma, whose keys have no quotes and whose texts have marks of their own.

_BLANKS = re.compile(r"\s*+")
_TOKEN = re.compile(
    r'''[rRuU]?+"""(?:[^"\\]|\\.|"(?!""))*"""|[rRuU]?+\'\'\'(?:[^'\\]|\\.|'(?!''))*\'\'\'
    |[rRuU]?+"[^"\\]*+(?:\\.[^"\\]*+)*"|[rRuU]?+'[^'\\]*+(?:\\.[^'\\]*+)*'
    |<escape>|<\|"\|>|[^\W\d][\w-]*+|[-+]?+(?:\d[\d_]*+(?:\.\d*+)?|\.\d++)(?:[eE][-+]?+\d++)?|[{}\[\]():=,]''',
    re.DOTALL | re.VERBOSE,
)
_CLOSING = {"[": "]", "(": ")"}
_WORDS = {"True": True, "true": True, "False": False, "false": False, "None": None, "null": None}
_MARKS = ("<escape>", '<|"|>')
_ESCAPE = re.compile(r"\\(x[0-9a-fA-F]{2}|u[0-9a-fA-F]{4}|U[0-9a-fA-F]{8}|[0-7]{1,3}|.)", re.DOTALL)
_ESCAPED = {"n": "\n", "t": "\t", "r": "\r", "b": "\b", "f": "\f", "a": "\a", "v": "\v", "\n": ""} | {
    char: char for char in "\\'\""
}


def _token(text: str, at: int) -> tuple[str, int]:
    found = _TOKEN.match(text, skip_blanks(text, at))
    if found is None:
        raise ValueError("no literal of Python")
    return found[0], found.end()


def _literal(text: str, at: int, depth: int) -> tuple[Any, int]:
    if depth > _MOST_DEPTH:
        raise ValueError(_TOO_DEEP)
    token, end = _token(text, at)
    if token in _MARKS:
        closing = text.find(token, end)
        if closing < 0:
            raise ValueError(f"{token} is never closed")
        return text[end:closing], closing + len(token)
    if token in _WORDS:
        return _WORDS[token], end
    if token in _CLOSING:
        return _sequence(text, end, _CLOSING[token], depth)
    if token == "{":
        return _mapping(text, end, depth)
    if token[-1] in "\"'":
        return _unquote(token), end
    return _number(token), end


def _sequence(text: str, at: int, closing: str, depth: int) -> tuple[list[Any], int]:
    values: list[Any] = []
    while True:
        token, end = _token(text, at)
        if token == closing:
            return values, end
        value, at = _literal(text, at, depth + 1)
        values.append(value)
        at = _behind_comma(text, at, closing)


def _mapping(text: str, at: int, depth: int) -> tuple[dict[str, Any], int]:
    values: dict[str, Any] = {}
    while True:
        key, end = _token(text, at)
        if key == "}":
            return values, end
        if key in "{}[]():=,":
            raise ValueError("there must be a name")
        if key[-1] in "\"'" or key in _MARKS:
            key, end = _literal(text, at, depth)
        colon, at = _token(text, end)
        if colon != ":":
            raise ValueError("behind a name must stand a colon")
        values[key], at = _literal(text, at, depth + 1)
        at = _behind_comma(text, at, "}")


def _behind_comma(text: str, at: int, closing: str) -> int:
    """Return where the next item begins, or the closing bracket stands."""
    token, end = _token(text, at)
    if token == closing:
        return at
    if token != ",":
        raise ValueError(f"there must be a comma or {closing}")
    return end


def _unquote(token: str) -> str:
    if token[0] == '"' and token[:3] != '"""':
        try:
            return str(json.loads(token, strict=False))
        except ValueError:
            pass  # an escape that only Python has
    raw = token[0] in "rR"
    body = token.lstrip("rRuU")
    quote = 3 if body[:3] in ('"""', "'''") and len(body) >= 6 else 1
    body = body[quote:-quote]
    return body if raw else _ESCAPE.sub(_unescape, body)


def _unescape(found: re.Match[str]) -> str:
    escape = found[1]
    if escape[0] in "xuU" and len(escape) > 1:
        return chr(int(escape[1:], 16))
    if escape[0] in "01234567":
        return chr(int(escape, 8))
    return _ESCAPED.get(escape, found[0])


def _number(token: str) -> int | float:
    try:
        return int(token)
    except ValueError:
        number = float(token)
    if not math.isfinite(number):
        raise ValueError(f"{token[:20]} is no finite number")
    return number
