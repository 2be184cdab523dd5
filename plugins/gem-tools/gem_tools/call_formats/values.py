"""Values as models write them: JSON with its slips, Python literals, and raw text that a schema gives its type."""

from __future__ import annotations

import ast
import contextlib
import json
import math
import re
from collections.abc import Mapping
from typing import Any

from gem_core.tools import json_at

_MOST_DEPTH = 99


class RawText(str):
    """Raw text of the response, not JSON; the schema of the tool decides its type."""

    __slots__ = ()


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
            source, end = _python_at(text, at)
            return _evaluated(source), end
        except ValueError:
            raise problem from None


def loaded(text: str) -> Any:
    """Return the one value that a text holds.

    Raises:
        ValueError: It holds none, or more.
    """
    value, end = value_at(text, 0)
    if text[end:].strip():
        raise ValueError(f"Extra data behind {text[:end].strip()[-20:]!r}")
    return value


def arguments_at(text: str, at: int) -> tuple[Any, int]:
    """Return the arguments from the ``(`` of a call in Python on, by name, and the index after its ``)``.

    A single argument without a name is returned as text.

    Raises:
        ValueError: They are no literals, or the call is never closed.
    """
    source, end = _python_at(text, at)
    try:
        call = ast.parse(f"call{source}", mode="eval").body
    except (SyntaxError, MemoryError, RecursionError) as error:
        raise ValueError("arguments are written as name=value") from error
    if not isinstance(call, ast.Call):
        raise ValueError("it is no call")
    if call.args:
        alone = _evaluated(call.args[0])
        if call.keywords or len(call.args) > 1 or not isinstance(alone, str):
            raise ValueError("arguments are written as name=value")
        return RawText(alone), end
    return {str(given.arg): _evaluated(given.value) for given in call.keywords}, end


def typed(value: Any, name: str, schema: Mapping[str, Any]) -> Any:
    """Return an argument that stands as raw text in the response as its parameter takes it.

    It stays text where the parameter may be text, or is not known; otherwise it is JSON or a Python literal, as far as
    it can be read.
    """
    if not isinstance(value, RawText):
        return value
    properties = schema.get("properties")
    if not _may_be_text(properties.get(name) if isinstance(properties, Mapping) else None, schema, 0):
        with contextlib.suppress(ValueError):
            return loaded(value)
    return str(value)


def _may_be_text(described: object, schema: Mapping[str, Any], depth: int) -> bool:
    """Tell whether a parameter takes text, as one of which nothing is said does."""
    if not isinstance(described, Mapping) or depth > 5:
        return True
    if isinstance(reference := described.get("$ref"), str):
        definitions = schema.get("$defs", schema.get("definitions"))
        name = reference.rpartition("/")[2]
        return _may_be_text(definitions.get(name) if isinstance(definitions, Mapping) else None, schema, depth + 1)
    options = [option for key in ("anyOf", "oneOf", "allOf") for option in described.get(key) or ()]
    if "type" not in described and options:
        return any(_may_be_text(option, schema, depth + 1) for option in options)
    kinds = described.get("type", "string")
    return kinds == "string" or (isinstance(kinds, list) and "string" in kinds)


# Literals of Python; and of Gemma, whose keys have no quotes and whose texts have marks of their own.

_TOKEN = re.compile(
    r'''\s*+([rRuU]?+"""(?:[^"\\]|\\.|"(?!""))*"""|[rRuU]?+\'\'\'(?:[^'\\]|\\.|'(?!''))*\'\'\'
    |[rRuU]?+"[^"\\]*+(?:\\.[^"\\]*+)*"|[rRuU]?+'[^'\\]*+(?:\\.[^'\\]*+)*'
    |<escape>|<\|"\|>|[^\W\d][\w-]*+|[-+]?+(?:\d[\d_]*+(?:\.\d*+)?|\.\d++)(?:[eE][-+]?+\d++)?|[{}\[\]():=,])''',
    re.DOTALL | re.VERBOSE,
)
_WORDS = {"true": "True", "false": "False", "null": "None", "True": "True", "False": "False", "None": "None"}
_MARKS = ("<escape>", '<|"|>')
_ESCAPE = re.compile(r"\\(.)", re.DOTALL)


def _python_at(text: str, at: int) -> tuple[str, int]:
    """Return the literal, or the arguments in brackets, that begin at a place, as plain Python, and the index after it.

    Raises:
        ValueError: They hold what is no literal, or are never closed.
    """
    parts: list[str] = []
    depth = 0
    while True:
        found = _TOKEN.match(text, at)
        if found is None or depth > _MOST_DEPTH:
            raise ValueError("no literal of Python")
        token, at = found[1], found.end()
        if token in _MARKS:
            closing = text.find(token, at)
            if closing < 0:
                raise ValueError(f"{token} is never closed")
            parts.append(repr(text[at:closing]))
            at = closing + len(token)
        elif token[-1] in "\"'":
            parts.append(repr(_unquoted(token)))
        elif token[0].isalpha() or token[0] == "_":
            follows = _TOKEN.match(text, at)
            is_key = follows is not None and follows[1] == ":"
            if token not in _WORDS and not is_key and (follows is None or follows[1] != "="):
                raise ValueError(f"{token[:50]} is no literal of Python")
            parts.append(repr(token) if is_key else _WORDS.get(token, token))
        else:
            if token[-1].isdigit() and not math.isfinite(float(token)):
                raise ValueError(f"{token[:20]} is no finite number")
            depth += (token in "([{") - (token in ")]}")
            parts.append(token)
        if depth == 0:
            return " ".join(parts), at


def _unquoted(token: str) -> str:
    """Return the text of a literal: in JSON, or in Python with its unknown escapes and line breaks as they are."""
    with contextlib.suppress(ValueError):
        return str(json.loads(token, strict=False))
    if token[0] not in "rR":
        token = _ESCAPE.sub(lambda found: found[0] if found[1] in "\\'\"abfnrtvxuU0123\n" else f"\\{found[0]}", token)
    quote = token[-1]
    if not token.endswith(quote * 3):
        token = token.replace("\n", "\\n").replace("\r", "\\r")
    return str(_evaluated(token))


def _evaluated(source: str | ast.expr) -> Any:
    """Return the value of a literal, as JSON has it.

    Raises:
        ValueError: It is none.
    """
    try:
        return json.loads(json.dumps(ast.literal_eval(source), allow_nan=False))
    except (SyntaxError, TypeError, MemoryError, RecursionError) as error:
        raise ValueError("no literal of Python") from error
