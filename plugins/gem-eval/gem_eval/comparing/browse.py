"""A list of flipped rows in a terminal, each one key away from both transcripts."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import click

from gem_eval.comparing.text import flip_line, flip_title
from gem_eval.show.diff import diff_lines
from gem_eval.show.lines import episode_lines
from gem_eval.show.paging import write_lines
from gem_eval.show.text import rule

if TYPE_CHECKING:
    from gem_eval.comparing.comparison import Comparison, Flip

_MOST_LINES = 12
_DOWN, _UP = ("j", "\x1b[B", "\x1bOB"), ("k", "\x1b[A", "\x1bOA")
_END = ("q", "\x1b", "\x03", "\x04")


def browse(comparison: Comparison, read_key: Callable[[], str] = click.getchar) -> None:
    """Let a person walk through the rows that flipped, and read their episodes.

    Args:
        comparison: With one flip at least.
        read_key: Returns the next key.
    """
    place, drawn = 0, 0
    while True:
        lines = _list_lines(comparison, place)
        click.echo((f"\x1b[{drawn}A\x1b[J" if drawn else "") + "\n".join(lines))
        drawn = len(lines)
        try:
            key = read_key()
        except (KeyboardInterrupt, EOFError):
            return
        if key in _END:
            return
        if key in _DOWN:
            place = min(place + 1, len(comparison.flips) - 1)
        elif key in _UP:
            place = max(place - 1, 0)
        elif key in ("\r", "\n", "d"):
            show_flip(comparison, comparison.flips[place], diff=key == "d")
            drawn = 0


def show_flip(comparison: Comparison, flip: Flip, *, diff: bool) -> None:
    """Write both episodes of a row: one after the other, or where they part."""
    one = comparison.a.run.episode(flip.episode_a)
    other = comparison.b.run.episode(flip.episode_b)
    if diff:
        write_lines(diff_lines((flip.episode_a.number, flip.episode_b.number), (one, other)))
        return

    def lines() -> Iterator[str]:
        for name, side, row, episode in (
            ("A", comparison.a, flip.episode_a, one),
            ("B", comparison.b, flip.episode_b, other),
        ):
            yield rule(f"{name}: {side.label}")
            yield from episode_lines(episode, row.number)
            yield ""

    write_lines(lines())


def _list_lines(comparison: Comparison, place: int) -> list[str]:
    """Return the part of the list around a place, each row in one line of the terminal."""
    width, height = shutil.get_terminal_size()
    room = max(min(_MOST_LINES, height - 4), 1)
    first = max(0, min(place - room // 2, len(comparison.flips) - room))
    lines = [click.style(f"{flip_title(comparison)}, {place + 1} of {len(comparison.flips)}", bold=True)]
    for number, flip in enumerate(comparison.flips[first : first + room], start=first):
        line = f"{'>' if number == place else ' '} {flip_line(comparison, flip)}"[: width - 1]
        lines.append(click.style(line, reverse=number == place))
    return [*lines, click.style("j, k: down, up · Enter: both transcripts · d: where they part · q: end", dim=True)]
