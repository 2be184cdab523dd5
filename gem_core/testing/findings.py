"""How the checks of tools, wrappers and plugins report: sentences that hold, and what was seen where they do not."""

from __future__ import annotations

from collections.abc import Callable

from gem_core.errors import GemError


class CheckError(GemError, AssertionError):
    """Something breaks promises; the message has one line for each."""


class Findings:
    """Collects what a check saw.

    Args:
        name: What is checked, as it is called in the report.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.kept: list[str] = []
        self.broken: dict[str, str] = {}

    def expect(self, promise: str, holds: bool, seen: object = "") -> bool:
        """Note whether a promise holds, and what was seen where it does not."""
        if holds:
            self.kept.append(promise)
        else:
            self.broken[promise] = " ".join(str(seen).split())
        return holds

    def attempt(self, promise: str, action: Callable[[], object]) -> bool:
        """Note whether a call returns; what it raises is what was seen."""
        try:
            action()
        except (Exception, SystemExit) as error:  # noqa: BLE001 - foreign code: whatever it raises breaks the promise
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
