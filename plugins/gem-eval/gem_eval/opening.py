"""Open the runs that a function or a command is given, and say what of them cannot be read."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import click

from gem_core.cli import counted
from gem_core.errors import ArgumentError
from gem_eval.records import Row, Run, open_run
from gem_eval.show.text import one_line


def opened(run: str | Path | Run) -> Run:
    """Return a run that may be open already; see ``open_run``."""
    return run if isinstance(run, Run) else open_run(run)


def require_episodes(run: Run) -> None:
    """Raise an error where a run has nothing to look at.

    Raises:
        ArgumentError: It has no episodes.
    """
    if not run.rows:
        unread = f"; {counted(run.damaged, 'line')} cannot be read as such" if run.damaged else ""
        raise ArgumentError(f"{run.path} holds no episodes (yet){unread}")


def refuse_seats(rows: Iterable[Row]) -> None:
    """Raise an error where rows are of seats, for commands that take episodes of one agent alone.

    Raises:
        ArgumentError: One is; the message names what reads it.
    """
    for row in rows:
        if row.seat is not None:
            raise ArgumentError(
                f"episode {row.number} is of several agents: it cannot be replayed or graded again; 'gem show' reads it"
            )


def warn_of_damage(run: Run) -> None:
    """Say on standard error which line of a run is left out and why, and how many there are."""
    if run.damage:
        number, reason = next(iter(run.damage.items()))
        more = f"; lines passed over in all: {run.damaged:,}" if run.damaged > 1 else ""
        click.echo(f"gem: {run.path}, line {number}: passed over, because {one_line(reason, 300)}{more}", err=True)
