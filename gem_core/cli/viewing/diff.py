"""Two episodes beside each other: whether they share a start, and turn by turn where they part."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

from gem_core.cli.viewing.pages import part_lines, text_lines
from gem_core.cli.viewing.terminal import Paint, one_line
from gem_core.cli.viewing.turns import Part, outcome_of, parts_of
from gem_core.records.episode import Episode, Transition

_STARTS = ("id", "seed", "options", "kwargs", "wrappers", "tools")
# The comparison of lines takes the square of their number.
_MOST_LINES = 2000


def diff_lines(numbers: tuple[int, int], episodes: tuple[Episode, Episode], paint: Paint) -> Iterator[str]:
    """Yield the lines that tell two episodes apart: ``-`` stands before the first's, ``+`` before the second's.

    Args:
        numbers: Their numbers in the file.
        episodes: The episodes.
        paint: For colours.
    """
    for mark, number, episode in zip("-+", numbers, episodes, strict=True):
        outcome = outcome_of(episode.success, None if episode.error is None else "")
        figures = f"{outcome}, return {episode.episode_return:g}, {episode.turns} turns, seed {episode.seed}"
        yield _marked(mark, f"episode {number} · {one_line(episode.id)} · {one_line(figures)}", paint)
    yield _said_of_start(*episodes)
    first, second = episodes
    parted: int | None = None
    same = 0
    for number, (one, other) in enumerate(zip_longest(first.transitions, second.transitions), start=1):
        differing = _differing(one, other)
        if not differing:
            same += 1
            continue
        if parted is None:
            parted = number
            yield ""
            yield paint(f"They part at turn {number}, with {_named(differing, one, other)}.", bold=True)
        if same:
            yield paint(f"… {same} turn{'s' if same > 1 else ''} alike", dim=True)
            same = 0
        yield paint(f"── turn {number} ".ljust(72, "─"), fg="blue")
        yield from _turn_lines(one, other, differing, paint)
    if same and parted is not None:
        yield paint(f"… {same} turn{'s' if same > 1 else ''} alike", dim=True)
    last_alike = first.final_observation == second.final_observation
    if parted is None:
        yield paint(
            f"All {same} turns are alike." if last_alike else f"All {same} turns are alike, but not what came last.",
            bold=True,
        )
    if not last_alike:
        yield paint("── end ".ljust(72, "─"), fg="blue")
        yield paint("final observation", bold=True)
        yield from _text_diff(_text(first.final_observation), _text(second.final_observation), paint)


def differing_starts(first: Episode, second: Episode) -> list[str]:
    """Return the names of what two episodes did not start alike from."""
    return [name for name in _STARTS if getattr(first, name) != getattr(second, name)]


def _said_of_start(first: Episode, second: Episode) -> str:
    names = differing_starts(first, second)
    if not names:
        return "They share a start: environment, seed, options, arguments, wrappers and tools."
    pairs = [f"{_label(name)} {_shown(getattr(first, name))} and {_shown(getattr(second, name))}" for name in names]
    return f"They do not share a start: {'; '.join(pairs)}."


def _label(name: str) -> str:
    return {"id": "environment", "kwargs": "arguments"}.get(name, name)


def _shown(value: Any) -> str:
    return one_line(str(value), 100)


def _fields(turn: Transition) -> dict[str, Any]:
    return {
        "observation": turn.observation,
        "response": (str(turn.action), turn.action.tool_calls),
        "reward": str(turn.reward),
        "flags": (turn.terminated, turn.truncated),
    }


def _differing(one: Transition | None, other: Transition | None) -> list[str]:
    if one is None or other is None:
        return ["end"]
    others = _fields(other)
    return [name for name, value in _fields(one).items() if value != others[name]]


def _named(differing: list[str], one: Transition | None, other: Transition | None) -> str:
    if differing == ["end"]:
        return f"the end of the {'first' if one is None else 'second'}"
    if differing[0] == "observation":
        return "the observation, although all before it was alike"
    return f"the {differing[0]}"


def _turn_lines(one: Transition | None, other: Transition | None, differing: list[str], paint: Paint) -> Iterator[str]:
    if one is None or other is None:
        mark, turn = ("+", other) if one is None else ("-", one)
        if turn is not None:
            yield f"only in the {'second' if mark == '+' else 'first'}"
            for line in _text(turn.observation).split("\n"):
                yield _marked(mark, line, paint)
            yield paint("response", bold=True)
            for line in _response(turn).split("\n"):
                yield _marked(mark, line, paint)
            yield paint("reward", bold=True)
            yield _marked(mark, _verdict(turn), paint)
        return
    for name, texts in (
        ("observation", (_text(one.observation), _text(other.observation))),
        ("response", (_response(one), _response(other))),
        ("reward", (_verdict(one), _verdict(other))),
    ):
        yield paint(name, bold=True)
        if texts[0] == texts[1]:
            yield from _alike(texts[0], name, paint)
        else:
            yield from _text_diff(*texts, paint)


def _alike(text: str, name: str, paint: Paint) -> Iterator[str]:
    if name == "observation":
        yield paint("  (alike)", dim=True)
    else:
        yield from text_lines(text, paint)


def _text_diff(first: str, second: str, paint: Paint) -> Iterator[str]:
    one, other = first.split("\n"), second.split("\n")
    if len(one) + len(other) > _MOST_LINES:
        yield f"  too long to compare line by line: {len(one):,} and {len(other):,} lines"
        return
    for place, line in enumerate(difflib.unified_diff(one, other, n=2, lineterm="")):
        if place < 2:
            continue  # The names of the files, which are none.
        if line.startswith("@@"):
            if not line.startswith(("@@ -1,", "@@ -1 ")):
                yield paint("  ⋯", dim=True)
        elif line.startswith(" "):
            yield f"  {paint.foreign(line[1:])}"
        else:
            yield _marked(line[0], line[1:], paint)


def _marked(mark: str, line: str, paint: Paint) -> str:
    text = Paint(False).foreign(line)
    return paint(f"{mark} {text}", fg="red" if mark == "-" else "green")


def _response(turn: Transition) -> str:
    calls = "".join(f"\n{call}" for call in turn.action.tool_calls or ())
    return str(turn.action) + calls


def _verdict(turn: Transition) -> str:
    flags = "".join(f", {name}" for name in ("terminated", "truncated") if getattr(turn, name))
    return f"{turn.reward:g}{flags}"


def _text(observation: Any) -> str:
    parts: list[Part] = parts_of(observation)
    return "\n".join(line.removeprefix("  ") for line in part_lines(parts, _AsItIs()))


class _AsItIs(Paint):
    """Leaves text of others to whoever shows it."""

    def __init__(self) -> None:
        super().__init__(False)

    def foreign(self, text: str) -> str:
        return text
