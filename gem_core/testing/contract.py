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
"""Every promise by its slug."""


def promise(mend: str, of: Kind = "any") -> Callable[[PromiseCheck], PromiseCheck]:
    """Register a check: its name is the slug, the first line of its docstring the sentence."""

    def enter(check: PromiseCheck) -> PromiseCheck:
        slug = check.__name__.rstrip("_").replace("_", "-")
        sentence = (check.__doc__ or "").partition("\n")[0]
        PROMISES[slug] = Promise(slug, sentence, mend, check, of)
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
        if self.broken:
            lines = [f"{self.name} breaks {len(self.broken)} of {tried} promises:"]
        else:
            lines = [f"{self.name} keeps all {tried} promises that were tried"]
        for slug, seen in self.broken.items():
            lines.append(f"  {slug}: {PROMISES[slug].sentence} Seen: {seen}. To mend it: {PROMISES[slug].mend}")
        for reason in dict.fromkeys(self.skipped.values()):
            slugs = [slug for slug, why in self.skipped.items() if why == reason]
            lines.append(f"  not tried, {', '.join(slugs)}: {reason}")
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines)


class ContractError(GemError, AssertionError):
    """An environment breaks promises; the message has one line for each, ``report`` the same as data."""

    def __init__(self, report: Report) -> None:
        super().__init__(str(report))
        self.report = report

    def __reduce__(self) -> tuple[type[ContractError], tuple[Report]]:
        return type(self), (self.report,)
