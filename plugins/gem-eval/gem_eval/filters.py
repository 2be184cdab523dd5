"""Filter and sort the episodes of a file."""

from __future__ import annotations

import fnmatch
import math
import re
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from operator import eq, ge, gt, le, lt, ne
from typing import TYPE_CHECKING, Any

from gem_core import Episode
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_eval.text_search import found_text, may_hold

if TYPE_CHECKING:
    from gem_eval.episode_file import Entry, EpisodeFile
    from gem_eval.run_entries import RunEntries

Comparison = Callable[[float], bool]

_OPERATORS = {">=": ge, "<=": le, "!=": ne, "==": eq, ">": gt, "<": lt, "=": eq, "": eq}
_COMPARISON = re.compile(r"\s*(>=|<=|!=|==|>|<|=|)\s*(\S+)\s*")

SORTS: dict[str, Callable[[Entry], Any]] = {
    "number": lambda entry: entry.number,
    "env": lambda entry: entry.id,
    "success": lambda entry: -1 if entry.success is None else int(entry.success),
    "return": lambda entry: -math.inf if math.isnan(entry.episode_return) else entry.episode_return,
    "turns": lambda entry: entry.turns,
    "seed": lambda entry: (isinstance(entry.seed, str), -1 if entry.seed is None else entry.seed),
    "group": lambda entry: entry.group or "",
}
"""What episodes can be sorted by; those that are alike stay in the order of the file."""


def select(
    file: EpisodeFile | RunEntries,
    entries: Iterable[Entry],
    *,
    env: str | None = None,
    success: bool | None = None,
    returns: Comparison | None = None,
    errors: bool | None = None,
    group: str | None = None,
    grep: str | None = None,
) -> Iterator[Entry]:
    """Yield those entries of a file that fit all conditions, as they come.

    Args:
        file: The file.
        entries: Its entries.
        env: Part of the id, or a glob for the whole of it.
        success: True for those that solved the task, False for those that are known not to have; see ``Entry``.
        returns: A test of the return; of several agents, of their sum.
        errors: True for those with an error of the machinery, False for those without.
        group: The group's name.
        grep: Text that stands in an observation, a response or an info; case does not count.
    """
    for entry in entries:
        if (
            (env is None or matches_id(entry.id, env))
            and (success is None or entry.success is success)
            and (returns is None or returns(entry.episode_return))
            and (errors is None or (entry.error is not None) is errors)
            and (group is None or entry.group == group)
            and (grep is None or _holds_text(file, entry, grep))
        ):
            yield entry


def at_seat(entries: Iterable[Entry], seat: str) -> Iterator[Entry]:
    """Yield the entries of one seat alone, of those episodes that have it."""
    for entry in entries:
        own = (entry.seats or {}).get(seat)
        if own is not None:
            figures = own._asdict()
            del figures["agent"]
            yield entry._replace(**figures, seats={seat: own})


def ordered(entries: Iterable[Entry], sort: str | None, reverse: bool, limit: int | None) -> Iterator[Entry]:
    """Yield entries in order, up to a limit; without a sort as they come.

    Args:
        entries: What fits.
        sort: A name of ``SORTS``; None keeps the order.
        reverse: The last first.
        limit: How many at most.
    """
    if sort is not None or reverse:
        entries = sorted(entries, key=SORTS[sort or "number"], reverse=reverse)
    return islice(entries, limit)


def matches_id(env_id: str, pattern: str) -> bool:
    """Whether an id fits: a glob fits the whole, anything else a part, and case does not count."""
    if any(character in pattern for character in "*?["):
        return fnmatch.fnmatchcase(env_id.casefold(), pattern.casefold())
    return pattern.casefold() in env_id.casefold()


def parse_comparison(text: str) -> Comparison:
    """Return the test that a comparison such as ``">0.5"`` stands for.

    Raises:
        ArgumentError: It is no comparison with a number.
    """
    found = _COMPARISON.fullmatch(text)
    try:
        if found is None:
            raise ValueError
        compare, bound = _OPERATORS[found[1]], float(found[2])
    except ValueError:
        raise ArgumentError(
            f"{text!r} is no comparison with a number; write '>0.5', '>=0.5', '<0.5', '<=0.5', '=1' or '!=0', in quotes"
        ) from None
    return lambda value: compare(value, bound)


def _holds_text(file: EpisodeFile | RunEntries, entry: Entry, text: str) -> bool:
    try:
        if not may_hold(file.line(entry), text):
            return False
        record = file.read(entry)
    except EpisodeFileError:
        return False  # Damaged in a part that the index does not look at.
    episodes = [record] if isinstance(record, Episode) else [record.seats[seat] for seat in entry.seats or record.seats]
    return any(found_text(episode, text) is not None for episode in episodes)
