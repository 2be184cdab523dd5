"""``Library``: the runs that are looked at, read by a thread in the background, and again as they grow."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from gem_core.errors import ArgumentError, GemError
from gem_eval.records import Row, Run
from gem_eval.records.run import RUN_FILE
from gem_eval.scores import compute_scores
from gem_eval.show.text import escaped

_LINES_AT_ONCE = 4000
_PAUSE_S = 0.4
_FOLDER_PAUSE_S = 2.0
_LIVE_S = 15.0
_SCORING_SHARE = 0.1
"""Share of the time that may go into computing scores of a run that grows."""


class ViewedRun:
    """A run with what is shown of it. ``rows`` is replaced as a whole, so that any thread may read it.

    Args:
        name: What pages and links call it.
        path: Its folder or file.

    Raises:
        ArgumentError: There is no run.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        self.path = path
        self.run = Run(path, read=False, joint=True)
        self.rows: list[Row] = []
        self.version = 0
        """Counts how often the rows have changed."""
        self.summary: dict[str, Any] = {"name": escaped(name), "path": escaped(str(path)), "reading": 0.0}
        self.summary |= {"version": 0, "scores": []}
        """What a list of runs says of it, as plain JSON."""
        self._scored_version = 0
        self._score_due = 0.0
        self._grown_at: float | None = None
        self._is_read = False

    def read(self) -> bool:
        """Read some of what was written since; return whether there may be more."""
        problem = ""
        new: list[Row] = []
        try:
            new = self.run.refresh(_LINES_AT_ONCE)
            info = self.run.info
        except (GemError, OSError) as error:
            problem, info = str(error), {}
        if new or len(self.run.rows) < len(self.rows):
            self.rows = self.run.rows
            self.version += 1
            # What was there from the start does not tell that the run goes on.
            self._grown_at = time.monotonic() if self._is_read else None
        more = bool(new) and self.run.share_read < 1
        self._is_read = self._is_read or not more
        self.summary = {
            **self.summary,
            "version": self.version,
            "episodes": len(self.rows),
            "reading": round(self.run.share_read, 2) if more else 1.0,
            "live": self._grown_at is not None and time.monotonic() < self._grown_at + _LIVE_S,
            "status": escaped(str(info.get("status", ""))),
            "planned": info["episodes"] if type(info.get("episodes")) is int else None,
            "damaged": self.run.damaged,
            "problem": escaped(problem),
        }
        if self._is_read:
            self.summary = {**self.summary, "scores": self._scores()}
        return more

    def _scores(self) -> list[dict[str, Any]]:
        started = time.monotonic()
        if self._scored_version == self.version or started < self._score_due:
            scores: list[dict[str, Any]] = self.summary["scores"]
            return scores
        self._scored_version = self.version
        found = compute_scores(each for row in self.rows for each in row.apart())
        taken = time.monotonic() - started
        self._score_due = started + taken / _SCORING_SHARE
        return [{name: _shown(getattr(score, name)) for name in _SCORE} for score in found]


_SCORE = (
    *("id", "model", "metric", "mean", "low", "high", "episodes", "rows"),
    *("errors", "truncated", "unscored", "unreadable"),
)


def _shown(value: object) -> Any:
    if isinstance(value, str):
        return escaped(value)
    return value if isinstance(value, int | float) and math.isfinite(value) else None


class Library:
    """The runs of some paths, in the order of the paths, then by name; those found later at the end.

    Args:
        paths: Folders of runs, files of episodes, and folders that hold such: those of runs that begin later are
            found as well.

    Raises:
        ArgumentError: A path has no run.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self._paths = list(paths)
        self._runs: dict[Path, ViewedRun] = {}
        self._stopped = threading.Event()
        self._folders_due = 0.0
        for path in self._paths:
            if not any(_runs_in(path)):
                raise ArgumentError(
                    f"there is no run in {path}: give the folder of a run that 'gem eval' wrote, a file of 'gem run', "
                    "or a folder that holds such"
                )
        self._find()

    @property
    def runs(self) -> list[ViewedRun]:
        """The runs."""
        return list(self._runs.values())

    def run(self, name: str) -> ViewedRun:
        """Return a run by its name.

        Raises:
            ArgumentError: There is none.
        """
        for viewed in self.runs:
            if escaped(viewed.name) == name:
                return viewed
        raise ArgumentError(f"there is no run {name!r:.200} here")

    def start(self) -> None:
        """Begin to read, in a thread."""
        threading.Thread(target=self._follow, name="gem-view", daemon=True).start()

    def stop(self) -> None:
        """Read no more."""
        self._stopped.set()

    def read(self) -> bool:
        """Look for runs, and read some of each; return whether there may be more."""
        if time.monotonic() >= self._folders_due:
            self._find()
            self._folders_due = time.monotonic() + _FOLDER_PAUSE_S
        return any([viewed.read() for viewed in self.runs])

    def _follow(self) -> None:
        while not self._stopped.is_set():
            if not self.read():
                self._stopped.wait(_PAUSE_S)

    def _find(self) -> None:
        names = {viewed.name for viewed in self.runs}
        for root in self._paths:
            for path in _runs_in(root):
                if path in self._runs:
                    continue
                name = path.resolve().name
                if name in names:  # of two folders: links need names that differ
                    name = f"{path.resolve().parent.name}/{name}"
                while name in names:
                    name += "+"
                names.add(name)
                self._runs[path] = ViewedRun(name, path)


def _runs_in(path: Path) -> Iterator[Path]:
    """Yield the runs of a path: itself, or those in the folder that it is."""
    if path.is_file() or (path / RUN_FILE).is_file():
        yield path
    elif path.is_dir():
        for each in sorted(path.iterdir()):
            if (each / RUN_FILE).is_file() or (each.suffix == ".jsonl" and each.is_file()):
                yield each
