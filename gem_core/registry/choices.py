"""Read the text that names tools or wrappers with their options, on the command line and in Python."""

from __future__ import annotations

import json
import re
from typing import Any

from gem_core.arguments import parse_choice
from gem_core.errors import ArgumentError

_PYTHON = {"True": True, "False": False, "None": None}
"""Python's words for constants, which ``gem info`` shows, beside those of JSON."""

_NAME = re.compile(r"[\w.-]+(:[A-Za-z_][\w.]*)?", re.ASCII)
OPTION = re.compile(r"\s*(\w+)\s*=(.*)", re.ASCII | re.DOTALL)
"""A name, and a value that ``option_value`` reads."""

_FORM = "'concat:max_turns=2,episode_stats' or JSON as in '[[\"concat\", {\"max_turns\": 2}]]'"


def parsed_choices(text: str, option: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the tools or wrappers that a text names, each with its options.

    A value of an option is JSON if it can be read as such, or Python's True, False or None, and text otherwise. A value
    that holds a comma needs the JSON form of the whole.

    Args:
        text: As in ``"python,search:top_k=2"``, or JSON.
        option: Its name in errors: ``"--tools"``, ``"wrappers"`` and the like.

    Raises:
        ArgumentError: It is neither a list of names nor JSON.
    """
    kind = option.lstrip("-")
    form = f"write {_FORM}"
    if text.lstrip().startswith(("[", "{")):
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ArgumentError(f"{option} is no valid JSON: {error}; {form}") from None
        rule = f"{option} must be a list of names, or of names with options ({form})"
        given = content.items() if isinstance(content, dict) else content  # {"search": {"top_k": 2}, "python": {}}
        return [parse_choice(each, rule, lambda name: isinstance(name, str)) for each in given]
    choices: list[tuple[str, dict[str, Any]]] = []
    for word in filter(str.strip, text.split(",")):
        head, equals, value = word.partition("=")
        name, _, key = head.rpartition(":") if equals else (head, "", "")
        name, key = name.strip(), key.strip()
        if (name and not _NAME.fullmatch(name)) or (equals and not (key.isidentifier() and (name or choices))):
            raise ArgumentError(f"{option}: {word!r} is no name; {form}")
        if ":" in name and kind in ("tools", "backend"):
            raise ArgumentError(f"{option}: {word!r} has an option without a value; {form}")
        if name:
            choices.append((name, {}))
        if equals:
            choices[-1][1][key] = option_value(value)
    return choices


def option_value(text: str) -> Any:
    """Return the value of one option: JSON if it can be read as such, or Python's True, False or None, or text."""
    if text in _PYTHON:
        return _PYTHON[text]
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text
