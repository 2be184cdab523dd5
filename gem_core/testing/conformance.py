"""``check_env``: tries every promise of the environment contract and names all that are broken."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from itertools import islice

from gem_core.env.wrapper import AnyEnv
from gem_core.errors import ArgumentError, GemError
from gem_core.registry.specs import EnvSpec
from gem_core.suggestions import did_you_mean
from gem_core.testing import promises, promises_agents  # noqa: F401 - they fill the table in this order
from gem_core.testing.contract import PROMISES, ContractError, Promise, Report
from gem_core.testing.findings import NotTriedError
from gem_core.testing.isolation import TookTooLongError, preserved
from gem_core.testing.subject import CheckLimits, Subject

__all__ = ["check_env", "promises_for"]

_SIGHTINGS = 20
"""Number of violations after which a promise is not tried further."""


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
    is not used. They are used in threads other than the caller's, as vector environments do. A ``MultiAgentEnv`` makes
    most of the same promises, each for every agent, and those of ``promises_agents.py``.

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
    subject = Subject(env_or_id, CheckLimits(seed, episodes, max_turns, step_timeout_s, reset_timeout_s))
    _make_once(subject)
    kept: list[str] = []
    skipped: dict[str, str] = {}
    broken: dict[str, str] = {}
    for promise in promises_for(several=subject.several):
        if promise.slug in skip:
            skipped[promise.slug] = skip[promise.slug]
            continue
        if "construct" in broken:
            skipped[promise.slug] = "it cannot be made; see 'construct'"
            continue
        try:
            seen = _tried(promise, subject)
        except NotTriedError as error:
            skipped[promise.slug] = str(error)
            continue
        if seen:
            broken[promise.slug] = seen
        else:
            kept.append(promise.slug)
    report = Report(subject.name, tuple(kept), skipped, broken, tuple(dict.fromkeys(subject.notes)))
    if broken:
        raise ContractError(report)
    return report


def promises_for(*, several: bool) -> list[Promise]:
    """Return what an environment of one agent, or of several, promises, in the order in which it is tried."""
    kinds = ("any", "several" if several else "one")
    return [promise for promise in PROMISES.values() if promise.of in kinds]


def _make_once(subject: Subject) -> None:
    """Make the environment, and raise only errors that the caller can fix; ``construct`` reports all others."""
    try:
        with preserved():
            subject.watch.run(subject.new)
            subject.watch.run(subject.close_all)
    except GemError:
        raise
    except (Exception, SystemExit):  # noqa: BLE001, S110 - another promise reports it
        pass


def _tried(promise: Promise, subject: Subject) -> str:
    """Try one promise; return how it is broken, or an empty string.

    Raises:
        NotTriedError: It cannot be tried.
    """
    seen: list[str] = []

    def body() -> None:
        try:
            seen.extend(islice(subject.sightings(promise.check), _SIGHTINGS))
        finally:
            # An abandoned thread must not close what a later promise has made.
            if subject.watch.is_live:
                subject.close_all()

    # The filters of warnings are put back here too, in case a thread that changed them is abandoned.
    with preserved(), warnings.catch_warnings():
        try:
            subject.watch.run(body)
        except TookTooLongError as error:
            subject.forget_all()
            seen.append(str(error))
    more = f" (and {len(seen) - 1} more)" if len(seen) > 1 else ""
    return " ".join(f"{seen[0]}{more}".split()) if seen else ""
