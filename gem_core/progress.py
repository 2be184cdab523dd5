"""How far a run is, on standard error: a bar in a terminal, else a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from types import TracebackType

    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

_PLAIN_EVERY_S = 10.0
_NARROW = 70  # columns


class Progress:
    """Shows how far a run is.

    Args:
        total: How many there are; None where that is not known.
        title: Shown before the bar.
        quiet: Show nothing, as when a person answers.
        unit: What is counted, for the lines without a bar.
    """

    def __init__(self, total: int | None, title: str, *, quiet: bool = False, unit: str = "episodes") -> None:
        self._total = total
        self._title = title
        self._quiet = quiet
        self._unit = unit
        self._bar: RichProgress | None = None
        self._task: TaskID | None = None
        self._last = time.monotonic()

    def __enter__(self) -> Self:
        if sys.stderr.isatty() and not self._quiet:
            self._start_bar()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, done: int, status: str = "") -> None:
        """Note that so many are done."""
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, completed=done, status=status)
        elif not self._quiet and time.monotonic() - self._last > _PLAIN_EVERY_S:
            self._last = time.monotonic()
            counted = f"{done} {self._unit}" if self._total is None else f"{done} of {self._total} {self._unit}"
            with suppress(OSError, ValueError):  # nobody reads it any more; the run goes on
                sys.stderr.write(f"gem: {counted}{', ' if status else ''}{status}\n")

    def _start_bar(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as RichProgress

        console = Console(stderr=True)
        count, status = MofNCompleteColumn(), TextColumn("{task.fields[status]}")
        # Where it is narrow, rich would cut the count.
        narrow = console.width < _NARROW
        self._bar = RichProgress(
            *([count, status] if narrow else [self._title, BarColumn(), count, status, TimeRemainingColumn()]),
            console=console,
            # What is printed meanwhile stands above the bar; where it goes elsewhere, it is none of the bar's matter.
            redirect_stdout=sys.stdout.isatty(),
        )
        self._task = self._bar.add_task(self._title, total=self._total, status="")
        self._bar.start()


def shown_progress(total: int | None) -> tuple[Callable[[int, int | None], None], Callable[[], None]]:
    """Return what shows how far a rollout is, and what ends the show."""
    progress = Progress(total, "episodes")
    progress.__enter__()
    return lambda done, _: progress.advance(done), lambda: progress.__exit__(None, None, None)
