"""The table of promises that make up the environment contract, and the report of a check."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from gem_core.errors import GemError
from gem_core.testing.subject import Subject

PromiseCheck = Callable[[Subject], Iterator[str]]
"""Tries one promise and yields each violation; raises ``NotTriedError`` if it cannot be tried."""

Kind = Literal["any", "one", "several"]
"""Which environments make a promise: all, those of one agent, or those of several."""


@dataclass(frozen=True)
class Promise:
    """One sentence of the environment contract.

    Args:
        slug: Its short, stable name.
        sentence: What is promised.
        mend: How an author can fix an environment that breaks it.
        check: The function that tries it.
        of: Which environments make it.
    """

    slug: str
    sentence: str
    mend: str
    check: PromiseCheck
    of: Kind


PROMISES: dict[str, Promise] = {}
"""Every promise by its slug, in the order in which they are tried."""


def promise(mend: str, of: Kind = "any") -> Callable[[PromiseCheck], PromiseCheck]:
    """Register a check: its name is the slug, the first line of its docstring the sentence."""

    def enter(check: PromiseCheck) -> PromiseCheck:
        slug = check.__name__.rstrip("_").replace("_", "-")
        PROMISES[slug] = Promise(slug, (check.__doc__ or "").partition("\n")[0], mend, check, of)
        return check

    return enter


@dataclass(frozen=True)
class Report:
    """What a check found.

    Args:
        name: The environment that was checked.
        kept: Slugs of the promises that were tried and kept.
        skipped: Slug and reason of each that could not be tried.
        broken: Slug of each broken promise, and what was seen.
        notes: Remarks that are not violations.
    """

    name: str
    kept: tuple[str, ...]
    skipped: Mapping[str, str]
    broken: Mapping[str, str]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        tried = len(self.kept) + len(self.broken)
        breaks = f"breaks {len(self.broken)} of {tried} promises:"
        lines = [f"{self.name} {breaks if self.broken else f'keeps all {tried} promises that were tried'}"]
        for slug, seen in self.broken.items():
            lines.append(f"  {slug}: {PROMISES[slug].sentence} Seen: {seen}. To mend it: {PROMISES[slug].mend}")
        for reason in dict.fromkeys(self.skipped.values()):
            slugs = [slug for slug, why in self.skipped.items() if why == reason]
            lines.append(f"  not tried, {', '.join(slugs)}: {reason}")
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])


class ContractError(GemError, AssertionError):
    """An environment breaks promises; the message has one line for each, ``report`` the same as data."""

    def __init__(self, report: Report) -> None:
        super().__init__(str(report))
        self.report = report

    def __reduce__(self) -> tuple[type[ContractError], tuple[Report]]:
        return type(self), (self.report,)
