"""``Findings``: collects which promises are kept and broken, and the place in the author's file."""

from __future__ import annotations

import traceback
from collections.abc import Callable

from gem_core.errors import GemError
from gem_core.failures import shown_place

_LONGEST_SHOWN = 80
_NOT_THE_AUTHORS = ("gem_core", "importlib", "gymnasium")


class NotTriedError(Exception):
    """A promise cannot be tried on this environment; the message is the reason."""


class CheckError(GemError, AssertionError):
    """Something breaks promises; the message has one line for each."""


class Findings:
    """Collects which promises a check found kept or broken.

    Args:
        name: What is checked, as it is called in the report.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.kept: list[str] = []
        self.broken: dict[str, str] = {}

    def expect(self, promise: str, holds: bool, seen: object = "") -> bool:
        """Record whether a promise holds, and otherwise what was seen."""
        if holds:
            self.kept.append(promise)
        else:
            self.broken[promise] = " ".join(str(seen).split())
        return holds

    def expect_equal(self, promise: str, found: object, expected: object) -> bool:
        """Record whether two values are equal, and otherwise both."""
        return self.expect(promise, found == expected, f"{found!r:.300} and {expected!r:.300}")

    def attempt(self, promise: str, action: Callable[[], object]) -> bool:
        """Record whether a call returns, and otherwise its exception."""
        try:
            action()
        except (Exception, SystemExit) as error:  # noqa: BLE001 - third-party code: all that it raises breaks the promise
            return self.expect(promise, False, f"{type(error).__name__}: {error}")
        return self.expect(promise, True)

    def result(self) -> list[str]:
        """Return the promises that were kept.

        Raises:
            CheckError: Some were not.
        """
        if self.broken:
            tried = len(self.kept) + len(self.broken)
            lines = [f"{self.name} breaks {len(self.broken)} of {tried} promises:"]
            lines += [f"  {promise}" + (f" Seen: {seen}" if seen else "") for promise, seen in self.broken.items()]
            raise CheckError("\n".join(lines))
        return self.kept


def shown(value: object) -> str:
    """Return a short representation on one line, safe to print."""
    if isinstance(value, str) and len(value) > _LONGEST_SHOWN:
        return f"{value[:_LONGEST_SHOWN]!a}... ({len(value):,} characters)"
    text = ascii(value)
    return text if len(text) <= 2 * _LONGEST_SHOWN else f"{text[: 2 * _LONGEST_SHOWN]}..."


def place_of(error: BaseException, package: str) -> str:
    """Return ``file:line`` of the last line of a package that an exception passed through.

    Args:
        error: The exception, with its traceback.
        package: Name of the author's package, or of any module in it.

    Returns:
        The place; the last line of other code if no line of the package was involved; ``""`` if there is no traceback.
    """
    if isinstance(error, SyntaxError) and error.filename and error.lineno:
        return shown_place(error.filename, error.lineno)
    author = package.partition(".")[0]
    by_author, by_others = "", ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        top = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if top == author:
            by_author = shown_place(frame.f_code.co_filename, line)
        elif top not in _NOT_THE_AUTHORS:
            by_others = shown_place(frame.f_code.co_filename, line)
    return by_author or by_others
