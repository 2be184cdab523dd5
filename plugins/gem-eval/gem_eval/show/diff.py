"""Compare two episodes: whether they have the same start, and turn by turn where they differ."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from itertools import zip_longest

from click import style

from gem_core import Episode
from gem_core.cli import counted
from gem_eval.show.lines import text_lines
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
        yield _marked(mark, f"episode {number} · {one_line(episode.id)} · {one_line(figures)}")
    yield _start_line(*episodes)
    parted = False
    alike = 0
    turns = (turn_views(episode, fold=False) for episode in episodes)
    for number, (one, other) in enumerate(zip_longest(*turns), start=1):
        difference = _difference(one, other)
        if not difference:
            alike += 1
            continue
        if not parted:
            parted = True
            yield ""
            yield heading(f"They part at turn {number}, with {difference}.")
        yield from _equal_turns_lines(alike)
        alike = 0
        yield rule(f"turn {number}")
        yield from _turn_lines(one, other)
    first, second = (text_of(parts_of(episode.final_observation)) for episode in episodes)
    if parted:
        yield from _equal_turns_lines(alike)
    else:
        yield heading(f"All {alike} turns are alike{'' if first == second else ', but not what came last'}.")
    if first != second:
        yield rule("end")
        yield heading("final observation")
        yield from _text_diff(first, second)


def _start_line(first: Episode, second: Episode) -> str:
    pairs = [
        f"{label} {one_line(str(one), 100)} and {one_line(str(other), 100)}"
        for name, label in _STARTS.items()
        if (one := getattr(first, name)) != (other := getattr(second, name))
    ]
    if not pairs:
        return "They share a start: environment, seed, options, arguments, wrappers and tools."
    return f"They do not share a start: {'; '.join(pairs)}."


def _equal_turns_lines(turns: int) -> list[str]:
    return [dim(f"… {counted(turns, 'turn')} alike")] if turns else []


def _difference(one: TurnView | None, other: TurnView | None) -> str:
    """Return what two turns first differ in, in words; empty where they are alike."""
    if one is None or other is None:
        return f"the end of the {'first' if one is None else 'second'}"
    first, second = _sections(one), _sections(other)
    apart = next((name for name, text in first.items() if text != second[name]), "")
    if apart == "observation":
        return "the observation, although all before it was alike"
    if apart == "reward" and str(one.reward) == str(other.reward):
        return "the flags"
    return apart and f"the {apart}"


def _turn_lines(one: TurnView | None, other: TurnView | None) -> Iterator[str]:
    sections = [_sections(turn) for turn in (one, other) if turn is not None]
    if len(sections) == 1:
        mark, episode = ("+", "second") if one is None else ("-", "first")
        yield f"only in the {episode}"
        for name, text in sections[0].items():
            yield heading(name)
            yield from (_marked(mark, line) for line in text.split("\n"))
        return
    first, second = sections
    for name, text in first.items():
        yield heading(name)
        if text != second[name]:
            yield from _text_diff(text, second[name])
        elif name == "observation":
            yield dim("  (alike)")
        else:
            yield from text_lines(text)


def _sections(turn: TurnView) -> dict[str, str]:
    said = [block.text for block in turn.blocks if block.label in ("response", "tool call")]
    ending = [flag for flag in turn.flags if flag in ("terminated", "truncated")]
    return {
        "observation": turn.blocks[0].text,
        "response": "\n".join(said),
        "reward": ", ".join([f"{turn.reward:g}", *ending]),
    }


def _text_diff(first: str, second: str) -> Iterator[str]:
    one, other = first.split("\n"), second.split("\n")
    if len(one) + len(other) > _MOST_LINES:
        yield f"  too long to compare line by line: {len(one):,} and {len(other):,} lines"
        return
    _, _, *lines = difflib.unified_diff(one, other, n=2, lineterm="")  # the first two name the files
    for line in lines:
        if line.startswith("@@"):
            if not line.startswith(("@@ -1,", "@@ -1 ")):
                yield dim("  ⋯")
        elif line.startswith(" "):
            yield f"  {highlighted(line[1:])}"
        else:
            yield _marked(line[0], line[1:])


def _marked(mark: str, line: str) -> str:
    return style(f"{mark} {escaped(line)}", fg="red" if mark == "-" else "green")
