"""How far a run is, on standard error: a bar in a terminal, else a line now and then."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress

LINE_EVERY_S = 10.0
_NARROW = 70  # columns


class Progress:
    """Shows how far a run is.

    Args:
        total: Number of units; None if unknown.
        title: Shown before the bar.
        quiet: Show nothing, as when a person answers.
        unit: Plural noun of the counted things, for the lines without a bar.
    """

    def __init__(self, total: int | None, title: str, *, quiet: bool = False, unit: str = "episodes") -> None:
        self._total = total
        self._title = title
        self._quiet = quiet
        self._unit = unit
        self._bar: RichProgress | None = None
        self._last_line = time.monotonic()

    def __enter__(self) -> Self:
        if sys.stderr.isatty() and not self._quiet:
            self._bar = _started_bar(self._title, self._total)
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, done: int, status: str = "") -> None:
        """Note that so many are done."""
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=done, status=status)
        elif not self._quiet and time.monotonic() - self._last_line > LINE_EVERY_S:
            self._last_line = time.monotonic()
            counted = f"{done} {self._unit}" if self._total is None else f"{done} of {self._total} {self._unit}"
            with suppress(OSError, ValueError):  # nobody reads standard error any more; the run goes on
                sys.stderr.write(f"gem: {counted}{', ' if status else ''}{status}\n")


def _started_bar(title: str, total: int | None) -> RichProgress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as RichProgress

    console = Console(stderr=True)
    count, status = MofNCompleteColumn(), TextColumn("{task.fields[status]}")
    # Where it is narrow, rich would cut the count.
    narrow = console.width < _NARROW
    bar = RichProgress(
        *([count, status] if narrow else [title, BarColumn(), count, status, TimeRemainingColumn()]),
        console=console,
        # In a terminal, what is printed meanwhile goes above the bar; a file or a pipe gets it as it is.
        redirect_stdout=sys.stdout.isatty(),
    )
    bar.add_task(title, total=total, status="")
    bar.start()
    return bar
