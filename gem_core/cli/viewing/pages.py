"""A list of episodes, and one episode turn by turn, as lines of text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import chain, islice

from gem_core.cli.layout import Layout
from gem_core.cli.viewing.index import Entry
from gem_core.cli.viewing.terminal import Paint, one_line
from gem_core.cli.viewing.turns import Part, TurnView, error_text, outcome_of, parts_of, start_of, turn_views
from gem_core.records.episode import Episode

_HEADERS = ("number", "environment", "outcome", "return", "turns", "seed", "group", "error")
_OUTCOME = _HEADERS.index("outcome")
_TO_THE_LEFT = ("environment", "outcome", "group", "error")
_IF_ANY = ("group", "error")
_DISPENSABLE = ("group", "seed", "turns", "return")
# Columns get the width of the first so many rows; what comes later may stand out.
_ROWS_AHEAD = 200
_WIDEST = (8, 60, 7, 10, 6, 17, 24, 200)
_LONGEST_REST = 300

OUTCOME_COLOURS = {"success": "green", "failure": "red", "unknown": "white", "error": "yellow"}


def list_lines(entries: Iterable[Entry], paint: Paint, width: int | None = None) -> Iterator[str]:
    """Yield the lines of a list: a header, then one line for each episode, as they come.

    Args:
        entries: The episodes.
        paint: For colours.
        width: Characters in a line: columns are left out to fit, and errors cut; None leaves all whole.
    """
    rows = (_cells(entry) for entry in entries)
    first = list(islice(rows, _ROWS_AHEAD))
    if not first:
        return
    used = [place for place, name in enumerate(_HEADERS) if name not in _IF_ANY or any(row[place] for row in first)]
    headers = [_HEADERS[place] for place in used]
    layout = Layout(
        headers,
        [[row[place] for place in used] for row in first],
        width,
        left=[place for place, name in enumerate(headers) if name in _TO_THE_LEFT],
        names=2,
        dispensable=[headers.index(name) for name in _DISPENSABLE if name in headers],
        tail=headers.index("error") if "error" in headers else None,
    )
    for line in layout.header():
        yield paint(line, bold=True)
    for row in chain(first, rows):
        colour = OUTCOME_COLOURS[row[_OUTCOME]]
        yield from layout.row([row[place] for place in used], {_OUTCOME: partial(paint, fg=colour)})


def episode_lines(episode: Episode, number: int, paint: Paint, *, full: bool = False) -> Iterator[str]:
    """Yield the lines of one episode: what it started from, each turn, and how it ended.

    Args:
        episode: The episode, its images as names of files.
        number: Its number in the file.
        paint: For colours.
        full: Whether what an observation repeats of the one before, and long infos, are shown as well.
    """
    outcome = outcome_of(episode.success, None if episode.error is None else "")
    yield paint(f"Episode {number} · {one_line(episode.id)}", bold=True)
    cut_off = "" if episode.cut_off is None else f", cut off by {episode.cut_off}"
    figures = f"return {episode.episode_return:g}, {_turns(episode.turns)}{cut_off}"
    yield f"{paint(outcome, fg=OUTCOME_COLOURS[outcome])}, {figures}"
    for name, value in start_of(episode).items():
        yield paint(f"{name}: ", dim=True) + _short(value, full)
    if not episode.transitions:
        yield from _section("observation", parts_of(episode.observation), paint)
    for turn in turn_views(episode, fold=not full):
        yield ""
        yield from _turn_lines(turn, episode.turns, paint, full)
    yield ""
    yield paint("── end ".ljust(72, "─"), fg="blue")
    yield from _section("final observation", parts_of(episode.final_observation), paint)
    if episode.error is not None:
        yield paint("error: ", fg="yellow") + _short(error_text(episode.error), True)
    yield f"{paint(outcome, fg=OUTCOME_COLOURS[outcome])}, {figures}"


def part_lines(parts: Iterable[Part], paint: Paint) -> Iterator[str]:
    """Yield the lines of an observation, indented; what is repeated is only counted."""
    hidden = 0
    for part in parts:
        if part.repeated:
            hidden += len(part.text)
            continue
        if hidden:
            yield paint(f"  … {hidden:,} characters as in the turn before (--full shows them)", dim=True)
            hidden = 0
        if part.kind == "role":
            yield paint(f"  [{one_line(part.text)}]", dim=True)
        elif part.kind == "image":
            yield paint(f"  [image {one_line(part.text)}]", fg="magenta")
        else:
            yield from text_lines(part.text, paint)


def text_lines(text: str, paint: Paint, mark: str = "  ") -> Iterator[str]:
    """Yield the lines of a text of others behind a mark, escaped."""
    for line in text.removesuffix("\n").split("\n"):
        yield f"{mark}{paint.foreign(line)}".rstrip(" ")


def _turn_lines(turn: TurnView, turns: int, paint: Paint, full: bool) -> Iterator[str]:
    yield paint(f"── turn {turn.number} of {turns} ".ljust(72, "─"), fg="blue")
    yield from _section("observation", turn.observation, paint)
    if turn.reasoning:
        yield paint("reasoning", bold=True)
        yield from text_lines(turn.reasoning, paint)
    yield paint("response", bold=True) + (paint(f"  {one_line(turn.reported)}", dim=True) if turn.reported else "")
    yield from text_lines(turn.response, paint) if turn.response else [paint("  (empty)", dim=True)]
    for call in turn.calls:
        yield paint("tool call  ", bold=True) + _short(call, True)
    sign = "green" if turn.reward > 0 else "red" if turn.reward < 0 else None
    flags = "".join(f", {flag}" for flag in turn.flags)
    yield paint("reward  ", bold=True) + paint(f"{turn.reward:g}", fg=sign) + flags
    if turn.feedback:
        yield from _section("feedback", turn.feedback, paint)
    if turn.error:
        yield paint("error  ", fg="yellow", bold=True) + _short(turn.error, True)
    for name, value in turn.rest.items():
        yield paint(f"{one_line(name)}: ", dim=True) + _short(value, full)


def _section(title: str, parts: list[Part], paint: Paint) -> Iterator[str]:
    yield paint(title, bold=True)
    yield from part_lines(parts, paint)


def _short(value: str, full: bool) -> str:
    return one_line(value, None if full else _LONGEST_REST)


def _turns(count: int) -> str:
    return f"{count} turn{'' if count == 1 else 's'}"


def _cells(entry: Entry) -> tuple[str, ...]:
    cells = (
        str(entry.number),
        entry.id,
        outcome_of(entry.success, entry.error),
        f"{entry.episode_return:.4g}",
        str(entry.turns),
        "-" if entry.seed is None else str(entry.seed),
        entry.group or "",
        entry.error or "",
    )
    return tuple(one_line(cell, widest) for cell, widest in zip(cells, _WIDEST, strict=True))
