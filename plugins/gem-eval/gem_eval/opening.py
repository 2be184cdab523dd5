"""Open the runs that a function or a command is given, and say what of them cannot be read."""

from __future__ import annotations

from pathlib import Path

import click

from gem_core.cli import counted
from gem_core.errors import ArgumentError
from gem_eval.records import Run, open_run


def opened(run: str | Path | Run) -> Run:
    """Return a run that may be open already; see ``open_run``."""
    return run if isinstance(run, Run) else open_run(run)


def require_episodes(run: Run) -> None:
    """Raise an error where a run has nothing to look at.

    Raises:
        ArgumentError: It has no episodes of one agent.
    """
    if not run.rows:
        unread = f"; {counted(run.damaged, 'line')} cannot be read as such" if run.damaged else ""
        raise ArgumentError(f"{run.path} holds no episodes of one agent (yet){unread}")


def warn_of_damage(run: Run) -> None:
    """Say on standard error how many lines of a run are left out."""
    if run.damaged:
        lines = counted(run.damaged, "line")
        click.echo(f"gem: {run.path}: passed over {lines} without a whole episode of one agent", err=True)
