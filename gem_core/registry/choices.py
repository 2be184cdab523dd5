"""Read the text that names tools or wrappers with their options, on the command line and in Python."""

from __future__ import annotations

import json
import re
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.registry.lookup import registry
from gem_core.registry.specs import ToolSpec, WrapperSpec

_PYTHON = {"True": True, "False": False, "None": None}
"""Python's words for constants, which ``gem info`` shows, beside those of JSON."""

# A name has no equals sign before its first colon, so a piece that has one is an option of the name before it.
_NAME = re.compile(r"\s*([\w.-]+)\s*(?::(.*))?", re.ASCII | re.DOTALL)
OPTION = re.compile(r"\s*(\w+)\s*=(.*)", re.ASCII | re.DOTALL)
"""A name, and a value that ``option_value`` reads."""

_FORMS = {
    "tools": "'python,search:top_k=2' or JSON as in '[[\"search\", {\"top_k\": 2}]]'",
    "wrappers": "'concat:max_turns=2,episode_stats' or JSON as in '[[\"concat\", {\"max_turns\": 2}]]'",
}


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
    if text.lstrip().startswith(("[", "{")):
        return _from_json(text, option)
    choices: list[tuple[str, dict[str, Any]]] = []
    words = text.split(",")
    while words:
        word = words.pop(0)
        setting, named = OPTION.fullmatch(word), _NAME.fullmatch(word)
        if setting and choices:
            choices[-1][1][setting[1]] = _value(setting[2], words)
        elif named:
            name, rest = named[1], named[2]
            if (
                rest is not None
                and option.lstrip("-") != "tools"
                and not OPTION.fullmatch(rest)
                and not _is_registered(name)
            ):
                path, _, rest = rest.partition(":")  # "package.module:Class", with its options behind another colon
                name, rest = f"{name}:{path}", rest or None
            choices.append((name, {}))
            if rest is not None:
                setting = OPTION.fullmatch(rest)
                if setting is None:
                    raise ArgumentError(f"{option}: {rest!r} is no option of {name!r}; write {_form(option)}")
                choices[-1][1][setting[1]] = _value(setting[2], words)
        elif word.strip():
            raise ArgumentError(f"{option}: {word!r} is no name; write {_form(option)}")
    return choices


def option_value(text: str) -> Any:
    """Return the value of one option: JSON if it can be read as such, or Python's True, False or None, or text."""
    return _value(text, [])


def _form(option: str) -> str:
    return _FORMS.get(option.lstrip("-"), _FORMS["wrappers"])


def _from_json(text: str, option: str) -> list[tuple[str, dict[str, Any]]]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ArgumentError(f"{option} is no valid JSON: {error}; write {_form(option)}") from None
    if isinstance(content, dict):  # {"search": {"top_k": 2}, "python": {}}
        content = list(content.items())
    choices = [
        (each, {}) if isinstance(each, str) else tuple(each) if isinstance(each, list | tuple) else ()
        for each in content
    ]
    for choice in choices:
        if len(choice) != 2 or not isinstance(choice[0], str) or not isinstance(choice[1], dict):
            raise ArgumentError(
                f"{option} must be a list of names, or of names with options, not {text:.200}; write {_form(option)}"
            )
    return choices


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
