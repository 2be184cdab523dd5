"""``check_env``: tries every promise of the environment contract and names all that are broken."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, GemError
from gem_core.registry.specs import EnvSpec
from gem_core.suggestions import did_you_mean
from gem_core.testing.calls import ThreadCalls, TookTooLongError, preserved
from gem_core.testing.findings import NotTriedError
from gem_core.testing.promises import OF_ONE, OF_SEVERAL, PROMISES, Promise
from gem_core.testing.subject import CheckLimits, Subject, subjects_of

_SIGHTINGS = 20
"""Number of violations after which a promise is not tried further."""


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


def check_env(
    env_or_id: str | EnvSpec | AnyEnv | Callable[[], AnyEnv],
    *,
    skip: Mapping[str, str] | None = None,
    seed: int = 0,
    episodes: int = 3,
    max_turns: int = 40,
    step_timeout_s: float = 30.0,
    reset_timeout_s: float = 300.0,
) -> Report:
    """Try everything that the environment contract promises.

    New instances are made for it, from the id or the class, or the arguments of the given instance, which itself
    is not used. They are used in a thread other than the caller's, as vector environments do. Of a ``MultiAgentEnv``
    each seat is tried as an environment of its own, while random agents play the others.

    Args:
        env_or_id: An id, a record, an environment with or without wrappers, or a class or function that
            makes one without arguments.
        skip: Promises that are not to be tried, each by its slug, with the reason.
        seed: Decides the seeds and the generated actions.
        episodes: Episodes that are played with sampled actions; one more is played with fixed ones.
        max_turns: Turns after which the check stops playing an episode.
        step_timeout_s: Limit of one step. A step that exceeds it is reported, and its thread abandoned.
        reset_timeout_s: Limit of any other call.

    Returns:
        What was tried and kept, what could not be tried and why, and notes.

    Raises:
        ContractError: Promises are broken; the message names each, with what was seen and how to mend it.
        GemError: The environment cannot be made, as with an unknown id or a missing requirement.
    """
    skip = skip or {}
    for slug in skip:
        if slug not in PROMISES:
            raise ArgumentError(f"no promise {slug!r}.{did_you_mean(slug, PROMISES)} There are: {', '.join(PROMISES)}")
    if episodes < 1 or max_turns < 1:
        raise ArgumentError(f"episodes and max_turns must be at least 1, not {episodes} and {max_turns}")
    calls = ThreadCalls()
    subjects = subjects_of(env_or_id, CheckLimits(seed, episodes, max_turns, step_timeout_s, reset_timeout_s), calls)
    kept: list[str] = []
    skipped: dict[str, str] = {}
    broken: dict[str, str] = {}
    for slug, promise in PROMISES.items():
        if slug in (OF_ONE if subjects[0].seats else OF_SEVERAL):
            continue
        if slug in skip or "construct" in broken:
            skipped[slug] = skip.get(slug, "it cannot be made; see 'construct'")
            continue
        seen, why_not = _tried(promise, subjects)
        if seen:
            broken[slug] = seen
        elif why_not:
            skipped[slug] = why_not
        else:
            kept.append(slug)
    calls.close()
    notes = dict.fromkeys(note for subject in subjects for note in subject.notes)
    report = Report(subjects[0].name, tuple(kept), skipped, broken, tuple(notes))
    if broken:
        raise ContractError(report)
    return report


def _tried(promise: Promise, subjects: Sequence[Subject]) -> tuple[str, str]:
    """Try one promise at each seat; return how it is broken and why it could not be tried, or empty strings."""
    reasons: list[str] = []
    for subject in subjects:
        seen: list[str] = []
        with preserved(), warnings.catch_warnings():
            try:
                seen.extend(islice(subject.sightings(promise.check), _SIGHTINGS))
            except NotTriedError as error:
                reasons.append(str(error))
            except TookTooLongError as error:
                subject.forget_all()
                seen.append(str(error))
            finally:
                subject.close_all()
        if seen:
            seat = "" if subject.seat is None else f"at the seat {subject.seat!r}, "
            more = f" (and {len(seen) - 1} more)" if len(seen) > 1 else ""
            return " ".join(f"{seat}{seen[0]}{more}".split()), ""
    return "", reasons[0] if len(reasons) == len(subjects) else ""
