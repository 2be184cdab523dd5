"""Variables in Compose files, ``${NAME:-default}``, and files of variables; those of this process are never read."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from gem_terminal.errors import TaskError

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_OPERATOR = re.compile(r":?[-?+]")
_DOLLAR = re.compile(r"\$")
_DOLLAR_OR_BRACE = re.compile(r"[$}]")
_MOST_CHARACTERS = 2_000_000
_DEEPEST = 20


class Substitution:
    """Puts values in the place of ``$NAME`` and ``${NAME}``, as Compose does; a name without a value is empty.

    Args:
        values: Values by name.
        missing: Called with each name that has no value and no default.

    Source: the Compose specification, "Interpolation".
    """

    def __init__(self, values: Mapping[str, str], missing: Callable[[str], None]) -> None:
        self.values = values
        self.missing = missing
        self._written = 0

    def __call__(self, text: str) -> str:
        """Return a text with its variables replaced.

        Raises:
            TaskError: A ``$`` that begins nothing, a variable that must have a value and has none, or a text that grows
                beyond measure.
        """
        if "$" not in text:
            return text
        result, end = self._until(text, 0, nested=0)
        return result if end >= len(text) else result + text[end:]

    def _until(self, text: str, position: int, *, nested: int) -> tuple[str, int]:
        """Read to the end, or to the brace that ends a default; return what was read, and where it ended."""
        if nested > _DEEPEST:
            raise TaskError(f"{text[:60]!r} has variables nested too deeply; expected {_DEEPEST} levels at most")
        parts: list[str] = []
        while position < len(text):
            if nested and text[position] == "}":
                break
            found = (_DOLLAR_OR_BRACE if nested else _DOLLAR).search(text, position)
            stop = found.start() if found else len(text)
            if stop > position:
                parts.append(text[position:stop])
                position = stop
                continue
            value, position = self._variable(text, position, nested)
            self._written += len(value)
            if self._written > _MOST_CHARACTERS:
                raise TaskError("the values of its variables are longer than two million characters")
            parts.append(value)
        return "".join(parts), position

    def _variable(self, text: str, position: int, nested: int) -> tuple[str, int]:
        if text.startswith("$$", position):
            return "$", position + 2
        braced = text.startswith("${", position)
        name = _NAME.match(text, position + (2 if braced else 1))
        if name is None:
            raise TaskError(f"{text[position : position + 40]!r} is no variable; write '$$' for a dollar sign")
        if not braced:
            return self._value(name[0]), name.end()
        end = name.end()
        operator = _OPERATOR.match(text, end)
        other = ""
        if operator is not None:
            # What is not used must not count as missing.
            inner = self if self._uses_other(name[0], operator[0]) else _silent(self)
            other, end = inner._until(text, operator.end(), nested=nested + 1)
            self._written = max(self._written, inner._written)
        if end >= len(text) or text[end] != "}":
            raise TaskError(f"{text[position : position + 40]!r} has no closing brace")
        return self._chosen(name[0], operator[0] if operator else "", other), end + 1

    def _uses_other(self, name: str, operator: str) -> bool:
        return self._has(name, operator) == operator.endswith("+")

    def _has(self, name: str, operator: str) -> bool:
        return bool(self.values.get(name)) if operator.startswith(":") else name in self.values

    def _chosen(self, name: str, operator: str, other: str) -> str:
        if not operator:
            return self._value(name)
        if operator.endswith("+"):
            return other if self._has(name, operator) else ""
        if self._has(name, operator):
            return self.values[name]
        if operator.endswith("?"):
            raise TaskError(
                f"the variable {name!r} has no value{': ' + other[:200] if other else ''}; give it in '.env'"
            )
        return other

    def _value(self, name: str) -> str:
        if name not in self.values:
            self.missing(name)
        return self.values.get(name, "")


def _silent(substitution: Substitution) -> Substitution:
    silent = Substitution(substitution.values, lambda name: None)
    silent._written = substitution._written
    return silent


def read_variables(text: str, named: str) -> dict[str, str]:
    r"""Return the variables of a file such as ``.env``: ``NAME=value`` on each line, with quotes and comments.

    Within double quotes ``\n``, ``\t``, ``\"`` and ``\\`` are escapes; variables in values are left as they are.

    Raises:
        TaskError: A line is none of these.
    """
    values: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if not stripped or stripped.startswith("#"):
            continue
        name, equals, value = stripped.removeprefix("export ").partition("=")
        name = name.strip()
        if not _NAME.fullmatch(name):
            raise TaskError(f"{named}: line {number} is {stripped[:60]!r}; expected NAME=value.")
        if equals:
            values[name] = _unquoted(value.strip())
    return values


def _unquoted(value: str) -> str:
    quote = value[:1]
    if quote in ("'", '"'):
        inner = re.match(r"'([^']*)'|\"((?:[^\"\\]|\\.)*)\"", value)
        if inner is None:
            return value
        if quote == "'":
            return inner[1]
        return re.sub(r"\\([nt\"\\])", lambda escape: {"n": "\n", "t": "\t"}.get(escape[1], escape[1]), inner[2])
    return re.split(r"\s#", value, maxsplit=1)[0].rstrip()
