"""A list of episodes, and one episode turn by turn, as lines for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from click import style

from gem_core import Episode
from gem_core.cli import Column, table_lines
from gem_core.records import Record
from gem_eval.show.text import dim, heading, highlighted, one_line, rule
from gem_eval.turns import (
    Block,
    TurnView,
    episodes_of,
    error_text,
    figures_of,
    outcome_of,
    outcome_of_row,
    parts_of,
    start_of,
    turn_views,
)

if TYPE_CHECKING:
    from gem_eval.records import Row

_LONGEST_VALUE = 300

_OUTCOME_COLOURS = {"success": "green", "failure": "red", "unscored": "white", "split": "white", "error": "yellow"}


def _column(name: str, widest: int, cell: Callable[[Row], object], rank: int | None = None, **options: Any) -> Column:
    return Column(name, lambda row: one_line(str(cell(row)), widest), rank, **{"text": True, **options})


_COLUMNS = [
    _column("number", 8, lambda row: row.number, text=False),
    _column("environment", 60, lambda row: row.id),
    _column("model", 40, lambda row: "" if row.seats else row.model, 5),
    _column("outcome", 8, outcome_of_row, colour=lambda row: _OUTCOME_COLOURS[outcome_of_row(row)]),
    _column("return", 10, lambda row: "" if len(row.seats or ()) > 1 else f"{row.episode_return:.4g}", 4, text=False),
    _column("turns", 6, lambda row: row.turns, 2, text=False),
    _column("cut off", 12, lambda row: row.cut_off or "", 3),
    _column("seed", 17, lambda row: "-" if row.seed is None else row.seed, 1, text=False),
    _column("group", 24, lambda row: row.group or "", 0),
    _column("agents and returns", 100, lambda row: _agents(row)),
    _column("error", 200, lambda row: row.error or ""),
]


def list_lines(rows: Sequence[Row], width: int | None = None) -> Iterator[str]:
    """Return the lines of a list: a header, then one line for each episode; columns that are empty have none.

    Args:
        rows: The episodes.
        width: Characters in a line: columns are left out to fit, and errors cut; None leaves all whole.
    """
    columns = [column for column in _COLUMNS if any(map(column.cell, rows))]
    return table_lines(columns, rows, width) if rows else iter(())


def episode_lines(episode: Record, number: int, *, full: bool = False) -> Iterator[str]:
    """Yield the lines of one episode: what it started from, each turn, and how it ended.

    Of several agents, each turn stands under its seat, in the order in which they acted.

    Args:
        episode: The episode, its images as names of files.
        number: Its number in the file.
        full: Whether what an observation repeats of the one before, and long infos, are shown as well.
    """
    alone = isinstance(episode, Episode)
    seats = episodes_of(episode)
    summary = [_summary(each) for each in seats]
    yield heading(f"Episode {number} · {one_line(episode.id)}")
    yield from summary
    yield from _facts(start_of(episode), full)
    for each in seats:
        if not each.transitions:
            yield from _block_lines(Block(f"observation{'' if alone else _of(each)}", parts_of(each.observation)))
    for turn in turn_views(episode, fold=not full):
        yield ""
        yield rule(f"turn {turn.number} of {episode.turns}{f' · {one_line(turn.seat)}' if turn.seat else ''}")
        yield from _turn_lines(turn, full)
    yield ""
    yield rule("end")
    for each in seats:
        yield from _block_lines(
            Block(f"final observation{'' if alone else _of(each)}", parts_of(each.final_observation))
        )
    if episode.error is not None:
        yield style("error: ", fg="yellow") + one_line(error_text(episode.error))
    yield from summary


def _summary(episode: Episode) -> str:
    outcome = outcome_of(episode.success, failed=episode.error is not None)
    who = "" if episode.seat is None else f"{one_line(episode.seat)}={one_line(str(episode.agent))}: "
    return f"{who}{style(outcome, fg=_OUTCOME_COLOURS[outcome])}, {figures_of(episode)}"


def _of(episode: Episode) -> str:
    return f" of {one_line(str(episode.seat))}"


def text_lines(text: str) -> Iterator[str]:
    """Yield the lines of a text of others, escaped and indented."""
    for line in text.removesuffix("\n").split("\n"):
        yield f"  {highlighted(line)}".rstrip(" ")


def _turn_lines(turn: TurnView, full: bool) -> Iterator[str]:
    for block in turn.blocks:
        yield from _block_lines(block)
    sign = "green" if turn.reward > 0 else "red" if turn.reward < 0 else None
    title = "reward up to its next turn  " if turn.seat else "reward  "
    yield heading(title) + ", ".join([style(f"{turn.reward:g}", fg=sign), *turn.flags])
    for block in turn.answer:
        yield from _block_lines(block)
    yield from _facts(turn.info, full)


def _block_lines(block: Block) -> Iterator[str]:
    if block.label in ("tool call", "error"):
        colour = "yellow" if block.label == "error" else None
        yield style(f"{block.label}  ", fg=colour, bold=True) + one_line(block.text)
        return
    yield heading(block.label) + (dim(f"  {one_line(block.aside)}") if block.aside else "")
    if block.repeated:
        yield dim(f"  … {block.repeated:,} characters as in the turn before (--full shows them)")
    if block.label == "response" and not block.parts:
        yield dim("  (empty)")
    for part in block.parts:
        if part.repeated:
            continue
        if part.kind == "role":
            yield dim(f"  {one_line(str(part))}")
        elif part.kind == "image":
            yield style(f"  {one_line(str(part))}", fg="magenta")
        else:
            yield from text_lines(part.text)


def _facts(facts: dict[str, str], full: bool) -> Iterator[str]:
    for name, value in facts.items():
        yield dim(f"{one_line(name)}: ") + one_line(value, None if full else _LONGEST_VALUE)


def _agents(row: Row) -> str:
    seats = row.seats or {}
    returns = {seat: f" {own.episode_return:.4g}" if len(seats) > 1 else "" for seat, own in seats.items()}
    return ", ".join(f"{seat}={own.model}{returns[seat]}" for seat, own in seats.items())
