"""``RunEntries``: the folder of a run, in the place of an ``EpisodeFile``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Self

from gem_core.errors import ArgumentError
from gem_core.records import ImageFolder, Record
from gem_eval.episode_file import Entry, EpisodeFile
from gem_eval.records import Row, open_run


class RunEntries:
    """The episodes of a run's folder: what ``EpisodeFile`` is for a file, from the run's own index.

    Args:
        path: The folder.

    Raises:
        ArgumentError: It is no run.
        EpisodeFileError: It cannot be read.
    """

    share_indexed = 1.0

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._run = open_run(path)
        self._rows = {row.number: row for row in self._run.rows}
        self.size = len(self._rows)
        """Zero for a run without episodes."""
        self.damaged: list[Entry] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        return

    @property
    def images(self) -> ImageFolder:
        """Folder of the images."""
        return self._run.images

    def entries(self) -> Iterator[Entry]:
        """Yield the episodes in the order in which they were first written."""
        yield from map(_entry, self._rows.values())

    def entry(self, number: int) -> Entry:
        """Return the entry of an episode.

        Raises:
            ArgumentError: There is none.
        """
        return _entry(self._row(number))

    def line(self, entry: Entry) -> bytes:
        """Return the line of an entry, as ``zstdcat`` prints it.

        Raises:
            EpisodeFileError: It is not there, or is damaged.
        """
        return self._run.line_bytes(self._row(entry.number))

    def read(self, entry: Entry) -> Record:
        """Return the episode of an entry; images stay names of files.

        Raises:
            EpisodeFileError: It is not there, or is damaged.
        """
        return self._run.record(self._row(entry.number))

    def _row(self, number: int) -> Row:
        if number not in self._rows:
            raise ArgumentError(
                f"no episode {number} in {self.path}, which has {self.size:,}. Run 'gem show {self.path}'"
            )
        return self._rows[number]


def open_episodes(path: str | Path) -> EpisodeFile | RunEntries:
    """Open what ``gem run`` or ``gem eval`` wrote.

    Raises:
        ArgumentError: A folder is no run.
        EpisodeFileError: It cannot be read.
    """
    return RunEntries(path) if Path(path).is_dir() else EpisodeFile(path)


def _entry(row: Row) -> Entry:
    return Entry(
        row.number,
        row.offset,
        row.length,
        id=row.id,
        success=row.success,
        episode_return=row.episode_return,
        turns=row.turns,
        error=row.error,
        seed=row.seed,
    )
