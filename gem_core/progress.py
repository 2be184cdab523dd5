"""How far a run is, on standard error: a bar in a terminal, else a line now and then."""

from __future__ import annotations

import math
import sys
import time
from contextlib import suppress
from typing import Self

LINE_EVERY_S = 10.0


class Progress:
    """Shows how far a run is.

    Args:
        total: Number of units; None if unknown.
        title: Shown before the bar.
        quiet: Show nothing, as when a person answers.
        unit: Plural noun of the counted things, for the lines without a bar.
    """

    def __init__(self, total: int | None, title: str, *, quiet: bool = False, unit: str = "episodes") -> None:
        from rich.console import Console  # not before a run, since it takes a while
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        self._total, self._unit = total, unit
        self._last_line = math.inf if quiet else time.monotonic()
        self._bar = Progress(
            title,
            BarColumn(bar_width=20),  # a narrow terminal still shows the count
            MofNCompleteColumn(),
            TextColumn("{task.fields[status]}"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            disable=quiet or not sys.stderr.isatty(),
            # In a terminal, what is printed meanwhile goes above the bar; a file or a pipe gets it as it is.
            redirect_stdout=sys.stdout.isatty(),
        )
        self._task = self._bar.add_task(title, total=total, status="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def advance(self, done: int, status: str = "") -> None:
        """Note that so many are done."""
        self._bar.update(self._task, completed=done, status=status)
        if self._bar.disable and time.monotonic() - self._last_line > LINE_EVERY_S:
            self._last_line = time.monotonic()
            counted = f"{done} {self._unit}" if self._total is None else f"{done} of {self._total} {self._unit}"
            with suppress(OSError, ValueError):  # nobody reads standard error any more; the run goes on
                sys.stderr.write(f"gem: {counted}{', ' if status else ''}{status}\n")
