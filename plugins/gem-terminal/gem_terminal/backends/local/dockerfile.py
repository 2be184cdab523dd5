"""Reading a Dockerfile into instructions: continuations, comments, directives, here-documents, flags, JSON forms.

Source: the Dockerfile reference of Docker's documentation, syntax 1.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from gem_terminal.errors import TaskError

_DIRECTIVE = re.compile(r"#\s*([A-Za-z][A-Za-z0-9]*)\s*=\s*(.*?)\s*$")
_FLAG = re.compile(r"--([a-z][a-z-]*)(?:=(\S*))?(?:\s+|$)")
_HEREDOC = re.compile(r"(?<![<\d])<<(-?)(['\"]?)([A-Za-z_][A-Za-z0-9_]*)\2")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_WITH_HEREDOCS = ("RUN", "COPY", "ADD")
_MOST_BYTES = 1_000_000
_MOST_DEPTH = 20


@dataclass(frozen=True)
class Heredoc:
    """A here-document.

    Args:
        name: The word that ends it.
        text: What is in it.
        literal: Whether its word is quoted: then no variables are put in.
    """

    name: str
    text: str
    literal: bool


@dataclass(frozen=True)
class Instruction:
    """One instruction.

    Args:
        name: In capital letters.
        value: What follows the name and the flags, on one line.
        flags: ``--name=value``.
        heredocs: Those that it opens.
        line: Where it begins.
    """

    name: str
    value: str
    flags: Mapping[str, str]
    heredocs: tuple[Heredoc, ...]
    line: int

    @property
    def words(self) -> tuple[str, ...] | None:
        """The words of its JSON form; None where it has another."""
        if not self.value.startswith("["):
            return None
        try:
            found = json.loads(self.value)
        except (ValueError, RecursionError):
            return None
        ours = isinstance(found, list) and all(isinstance(word, str) for word in found)
        return tuple(found) if ours else None


def read(text: str) -> tuple[list[Instruction], str]:
    """Return the instructions of a Dockerfile, and its escape character.

    Raises:
        TaskError: It cannot be read; names the line.
    """
    if len(text) > _MOST_BYTES:
        raise TaskError(f"the Dockerfile has {len(text)} characters; at most {_MOST_BYTES} are read")
    lines = re.split(r"\r?\n", text.removeprefix("\ufeff"))
    escape, first = _directives(lines)
    found = list(_instructions(lines, first, escape))
    if not found:
        raise TaskError("the Dockerfile has no instruction")
    return found, escape


def _directives(lines: list[str]) -> tuple[str, int]:
    """Return the escape character, and where directives end."""
    escape = "\\"
    for number, line in enumerate(lines):
        match = _DIRECTIVE.match(line.strip())
        if match is None:
            return escape, number
        if match[1].lower() == "escape":
            if match[2] not in ("\\", "`"):
                raise TaskError(f"Dockerfile, line {number + 1}: escape={match[2]!r}; it is '\\' or '`'")
            escape = match[2]
    return escape, len(lines)


def _instructions(lines: list[str], number: int, escape: str) -> Iterator[Instruction]:
    while number < len(lines):
        start = number
        line, number = _joined(lines, number, escape)
        if not line:
            continue
        name, _, rest = line.partition(" ") if " " in line else line.partition("\t")
        name, _, tabbed = name.partition("\t")
        rest = f"{tabbed} {rest}".strip() if tabbed else rest.strip()
        name = name.upper()
        if not name.isascii() or not name.isalpha():
            raise TaskError(f"Dockerfile, line {start + 1}: {name[:40]!r} is no instruction")
        heredocs: list[Heredoc] = []
        if name in _WITH_HEREDOCS:
            for match in _HEREDOC.finditer(rest):
                document, number = _heredoc(lines, number, match, start)
                heredocs.append(document)
        flags, value = _flags(rest)
        yield Instruction(name, value, flags, tuple(heredocs), start + 1)


def _joined(lines: list[str], number: int, escape: str) -> tuple[str, int]:
    """Return an instruction's lines as one, without comments and empty lines, and the number of the next."""
    whole = ""
    while number < len(lines):
        line = lines[number]
        number += 1
        bare = line.strip()
        if bare.startswith("#") or (not bare and whole):
            if not whole:
                return "", number
            continue
        line = line.rstrip() if whole else bare
        if line.endswith(escape):
            whole += line[: -len(escape)]
            continue
        return (whole + line).strip(), number
    return whole.strip(), number


def _heredoc(lines: list[str], number: int, match: re.Match[str], start: int) -> tuple[Heredoc, int]:
    taken: list[str] = []
    while number < len(lines):
        line = lines[number].lstrip("\t") if match[1] else lines[number]
        number += 1
        if line == match[3]:
            return Heredoc(match[3], "".join(f"{each}\n" for each in taken), bool(match[2])), number
        taken.append(line)
    raise TaskError(f"Dockerfile, line {start + 1}: the here-document {match[3]!r} has no end")


def _flags(rest: str) -> tuple[dict[str, str], str]:
    flags = {}
    while match := _FLAG.match(rest):
        flags[match[1]] = match[2] or ""
        rest = rest[match.end() :]
    return flags, rest


def expand(text: str, values: Mapping[str, str], escape: str = "\\", *, depth: int = 0) -> str:
    """Put variables in, as ``$name``, ``${name}``, ``${name:-other}`` and ``${name:+other}``; quotes stay.

    Raises:
        TaskError: A form that this reader does not know.
    """
    if depth > _MOST_DEPTH:
        raise TaskError("the Dockerfile has too many variables inside one another")
    out: list[str] = []
    place, single = 0, False
    while place < len(text):
        character = text[place]
        if character == escape and not single and place + 1 < len(text):
            out.append(text[place + 1] if text[place + 1] == "$" else text[place : place + 2])
            place += 2
            continue
        if character == "'":
            single = not single
        if character != "$" or single:
            out.append(character)
            place += 1
            continue
        value, place = _variable(text, place, values, escape, depth)
        out.append(value)
    return "".join(out)


def _variable(text: str, place: int, values: Mapping[str, str], escape: str, depth: int) -> tuple[str, int]:
    match = _NAME.match(text, place + 1)
    if match:
        return values.get(match[0], ""), match.end()
    if not text.startswith("${", place):
        return "$", place + 1
    end = _closing(text, place + 2)
    inner = text[place + 2 : end]
    match = _NAME.match(inner)
    if match is None:
        raise TaskError(f"the Dockerfile's variable '${{{inner[:60]}}}' has no name")
    name, rest = match[0], inner[match.end() :]
    value = values.get(name)
    if not rest:
        return value or "", end + 1
    form = rest[:2] if rest.startswith(":") else rest[:1]
    other = rest[len(form) :]
    there = bool(value) if form.startswith(":") else value is not None
    if form in (":-", "-"):
        return (value or "") if there else expand(other, values, escape, depth=depth + 1), end + 1
    if form in (":+", "+"):
        return expand(other, values, escape, depth=depth + 1) if there else "", end + 1
    raise TaskError(f"the Dockerfile's variable '${{{inner[:60]}}}' has a form that is not known here: use 'docker'")


def _closing(text: str, place: int) -> int:
    depth = 1
    for number in range(place, len(text)):
        depth += (text[number] == "{") - (text[number] == "}")
        if not depth:
            return number
    raise TaskError(f"the Dockerfile's variable '{text[place - 2 : place + 40]}' is not closed")


def split(text: str, escape: str = "\\") -> list[str]:
    """Return the words of a value, quotes taken off.

    Raises:
        TaskError: A quote is not closed.
    """
    words: list[str] = []
    word: list[str] | None = None
    quote = ""
    place = 0
    while place < len(text):
        character = text[place]
        place += 1
        if quote:
            if character == quote:
                quote = ""
            elif character == escape and quote == '"' and place < len(text) and text[place] in f'"{escape}$':
                (word := word or []).append(text[place])
                place += 1
            else:
                (word := word or []).append(character)
        elif character in "'\"":
            quote, word = character, word or []
        elif character == escape and place < len(text):
            (word := word or []).append(text[place])
            place += 1
        elif character.isspace():
            if word is not None:
                words.append("".join(word))
            word = None
        else:
            (word := word or []).append(character)
    if quote:
        raise TaskError(f"the Dockerfile's {text[:60]!r} has a quote that is not closed")
    return words if word is None else [*words, "".join(word)]


def pairs(text: str, escape: str = "\\") -> dict[str, str]:
    """Return the variables of ``ENV``: ``NAME=value …``, or the old ``NAME value``.

    Raises:
        TaskError: It has neither form.
    """
    first = text.split(None, 1)
    if first and "=" not in first[0]:
        if len(first) < 2:
            raise TaskError(f"the Dockerfile's 'ENV {text[:60]}' gives no value")
        return {first[0]: first[1]}
    found = {}
    for word in split(text, escape):
        name, equals, value = word.partition("=")
        if not equals or not name:
            raise TaskError(f"the Dockerfile's 'ENV … {word[:60]}' is not NAME=value")
        found[name] = value
    return found
