"""Which episodes of a file are shown, and in which order."""

from __future__ import annotations

import fnmatch
import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

from gem_core.cli.viewing.index import Entry, EpisodeFile
from gem_core.errors import ArgumentError, EpisodeFileError

_OPERATORS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "!=": operator.ne,
    "==": operator.eq,
    ">": operator.gt,
    "<": operator.lt,
    "=": operator.eq,
    "": operator.eq,
}
_COMPARISON = re.compile(r"\s*(>=|<=|!=|==|>|<|=|)\s*(\S+)\s*")
# What stands in a line of JSON as it stands in the text.
_PLAIN_RUN = re.compile(r"[A-Za-z0-9 .,:;=()_-]+", re.ASCII)

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


@dataclass(frozen=True)
class Filters:
    """What an episode must be to be shown.

    Args:
        env: Part of the id, or a glob for the whole of it.
        success: True for those that solved the task, False for those that are known not to have.
        returns: A comparison with the return, as in ``">0.5"``.
        errors: True for those with an error of the machinery, False for those without.
        group: The group's name.
        grep: Text that stands in an observation, a response or an info; case does not count.
    """

    env: str | None = None
    success: bool | None = None
    returns: str | None = None
    errors: bool | None = None
    group: str | None = None
    grep: str | None = None

    def __post_init__(self) -> None:
        if self.returns is not None:
            parse_comparison(self.returns)

    def select(self, file: EpisodeFile) -> Iterator[Entry]:
        """Yield the entries of the episodes that fit, in the order of the file, as they are found."""
        compare = None if self.returns is None else parse_comparison(self.returns)
        for entry in file.entries():
            if (
                (self.env is None or matches_id(entry.id, self.env))
                and (self.success is None or entry.success is self.success)
                and (compare is None or compare(entry.episode_return))
                and (self.errors is None or (entry.error is not None) is self.errors)
                and (self.group is None or entry.group == self.group)
                and (self.grep is None or self._holds_text(file, entry, self.grep))
            ):
                yield entry

    def _holds_text(self, file: EpisodeFile, entry: Entry, text: str) -> bool:
        # A search of the raw line spares parsing most of those without the text.
        run = max(_PLAIN_RUN.findall(text), key=len, default="")
        if run and not re.search(re.escape(run).encode("ascii"), file.line(entry), re.IGNORECASE):
            return False
        try:
            episode = file.read(entry)
        except EpisodeFileError:
            return False  # A part that the list does not look at is damaged.
        turns = [
            (turn.observation, str(turn.action), turn.action.reported(), turn.info) for turn in episode.transitions
        ]
        shown = (episode.id, episode.observation, episode.info, turns, episode.final_observation)
        wanted = text.casefold()
        return any(wanted in part.casefold() for part in _texts(shown))


def chosen(entries: Iterable[Entry], sort: str | None, reverse: bool, limit: int | None) -> Iterator[Entry]:
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


def parse_comparison(text: str) -> Callable[[float], bool]:
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


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for part in value.values():
            yield from _texts(part)
    elif isinstance(value, list | tuple):
        for part in value:
            yield from _texts(part)
