"""Compare two episodes: whether they have the same start, and turn by turn where they differ."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from itertools import zip_longest

from click import style

from gem_core import Episode
from gem_core.cli import counted
from gem_eval.show.text import dim, escaped, heading, highlighted, one_line, rule
from gem_eval.turns import TurnView, outcome_of, parts_of, text_of, turn_views

# What two episodes may start differently from, and what it is called.
_STARTS = {
    "id": "environment",
    "seed": "seed",
    "options": "options",
    "kwargs": "arguments",
    "wrappers": "wrappers",
    "tools": "tools",
}
# Comparing lines takes time that grows with the square of their number.
_MOST_LINES = 2000


def diff_lines(numbers: tuple[int, int], episodes: tuple[Episode, Episode]) -> Iterator[str]:
    """Yield the lines of a comparison: ``-`` marks those of the first episode, ``+`` those of the second.

    Args:
        numbers: Their numbers in the file.
        episodes: The episodes.
    """
    for mark, number, episode in zip("-+", numbers, episodes, strict=True):
        outcome = outcome_of(episode.success, failed=episode.error is not None)
        figures = f"{outcome}, return {episode.episode_return:g}, {episode.turns} turns, seed {episode.seed}"
        yield _marked(f"{mark}episode {number} · {one_line(episode.id)} · {one_line(figures)}")
    yield _start_line(*episodes)
    parted = alike = 0
    turns = (map(_turn_lines, turn_views(episode, fold=False)) for episode in episodes)
    for number, (one, other) in enumerate(zip_longest(*turns, fillvalue=()), start=1):
        if one == other:
            alike += 1
            continue
        if not parted:
            parted = number
            yield ""
            yield heading(f"They part at turn {number}, with {_what_differs(one, other)}.")
        if alike:
            yield dim(f"… {counted(alike, 'turn')} alike")
        alike = 0
        yield rule(f"turn {number}")
        yield from _differing_lines(one, other)
    first, second = (text_of(parts_of(episode.final_observation)).split("\n") for episode in episodes)
    if alike:
        ending = "" if parted or first == second else ", but not what came last"
        yield dim(f"… {counted(alike, 'turn')} alike") if parted else heading(f"All {alike} turns are alike{ending}.")
    if first != second:
        yield rule("final observation")
        yield from _differing_lines(first, second)


def _start_line(first: Episode, second: Episode) -> str:
    pairs = [
        f"{label} {one_line(str(one), 100)} and {one_line(str(other), 100)}"
        for name, label in _STARTS.items()
        if (one := getattr(first, name)) != (other := getattr(second, name))
    ]
    if not pairs:
        return "They share a start: environment, seed, options, arguments, wrappers and tools."
    return f"They do not share a start: {'; '.join(pairs)}."


def _turn_lines(turn: TurnView) -> list[str]:
    """Return what is compared of a turn: what was seen and said, without what a server reports, and the reward."""
    lines = []
    for block in turn.blocks:
        if block.label != "reasoning":
            lines += [block.label, *(f"  {line}" for line in block.text.split("\n"))]
    return [*lines, ", ".join([f"reward  {turn.reward:g}", *turn.flags])]


def _what_differs(one: Sequence[str], other: Sequence[str]) -> str:
    if not one or not other:
        return f"the end of the {'second' if one else 'first'}"
    same = next(place for place, (line, also) in enumerate(zip(one, other, strict=False)) if line != also)
    in_block = one[same].startswith(" ") or other[same].startswith(" ")
    label = [line for line in one[: same + (not in_block)] if not line.startswith(" ")][-1].split("  ")[0]
    return f"the {label}{', although all before it was alike' if label == 'observation' else ''}"


def _differing_lines(one: Sequence[str], other: Sequence[str]) -> Iterator[str]:
    if len(one) + len(other) > _MOST_LINES:
        yield f"  too long to compare line by line: {len(one):,} and {len(other):,} lines"
        return
    _, _, *lines = difflib.unified_diff(one, other, n=2, lineterm="")  # the first two name the files
    for line in lines:
        if not line.startswith("@@"):
            yield _marked(line)
        elif not line.startswith(("@@ -1,", "@@ -1 ")):
            yield dim("  ⋯")


def _marked(line: str) -> str:
    if line.startswith(" "):
        return f"  {highlighted(line[1:])}"
    return style(f"{line[0]} {escaped(line[1:])}", fg="red" if line[0] == "-" else "green")
