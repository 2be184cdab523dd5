"""Read the text that names tools or wrappers with their options, on the command line and in Python."""

from __future__ import annotations

import json
import re
from typing import Any

from gem_core.arguments import parse_choice
from gem_core.errors import ArgumentError
from gem_core.registry.lookup import registry
from gem_core.registry.specs import ToolSpec, WrapperSpec

_PYTHON = {"True": True, "False": False, "None": None}
"""Python's words for constants, which ``gem info`` shows, beside those of JSON."""

# A name or "package.module:Class", an option, or both with a colon between them.
_WORD = re.compile(
    r"\s*(?:(?P<name>[\w.-]+(?::[A-Za-z_][\w.]*(?=\s*(?::|$)))?)\s*(?::|$))?\s*(?:(?P<option>\w+)\s*=(?P<value>.*))?",
    re.ASCII | re.DOTALL,
)
OPTION = re.compile(r"\s*(\w+)\s*=(.*)", re.ASCII | re.DOTALL)
"""A name, and a value that ``option_value`` reads."""

_TOOL_FORM = "'python,search:top_k=2' or JSON as in '[[\"search\", {\"top_k\": 2}]]'"
_FORM = "'concat:max_turns=2,episode_stats' or JSON as in '[[\"concat\", {\"max_turns\": 2}]]'"


def parsed_choices(text: str, option: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the tools or wrappers that a text names, each with its options.

    A value of an option is JSON if it can be read as such, commas included, or Python's True, False or None, and
    text otherwise.

    Args:
        text: As in ``"python,search:top_k=2"``, or JSON.
        option: Its name in errors: ``"--tools"``, ``"wrappers"`` and the like.

    Raises:
        ArgumentError: It is neither a list of names nor JSON.
    """
    kind = option.lstrip("-")
    form = f"write {_TOOL_FORM if kind == 'tools' else _FORM}"
    if text.lstrip().startswith(("[", "{")):
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ArgumentError(f"{option} is no valid JSON: {error}; {form}") from None
        rule = f"{option} must be a list of names, or of names with options ({form})"
        given = content.items() if isinstance(content, dict) else content  # {"search": {"top_k": 2}, "python": {}}
        return [parse_choice(each, rule, lambda name: isinstance(name, str)) for each in given]
    choices: list[tuple[str, dict[str, Any]]] = []
    words = text.split(",")
    while words:
        word = words.pop(0)
        match = _WORD.fullmatch(word)
        if match is None or (match["option"] and not match["name"] and not choices):
            raise ArgumentError(f"{option}: {word!r} is no name; {form}")
        if match["name"]:
            head, _, rest = match["name"].partition(":")
            if rest and (kind in ("tools", "backend") or _is_registered(head)):
                raise ArgumentError(f"{option}: {rest!r} is no option of {head!r}; {form}")
            choices.append((match["name"], {}))
        if match["option"]:
            choices[-1][1][match["option"]] = _value(match["value"], words)
    return choices


def option_value(text: str) -> Any:
    """Return the value of one option: JSON if it can be read as such, or Python's True, False or None, or text."""
    return _value(text, [])


def _value(text: str, following: list[str]) -> Any:
    """Return the value of an option; a list, an object or a text in quotes takes what it needs of what follows."""
    if text in _PYTHON:
        return _PYTHON[text]
    most = len(following) if text.lstrip()[:1] in ("[", "{", '"') else 0
    for count in range(most + 1):
        try:
            value = json.loads(",".join([text, *following[:count]]))
        except (ValueError, RecursionError):
            continue
        del following[:count]
        return value
    return text


def _is_registered(name: str) -> bool:
    return any(record.name == name for kind in (WrapperSpec, ToolSpec) for record in registry().specs(kind))
