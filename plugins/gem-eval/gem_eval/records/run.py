"""``Run``: reads a run, also while it grows."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from gem_core import Episode
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import ImageFolder, Record, record_from_dict
from gem_eval.records.frames import decompressed, frames, unpack
from gem_eval.records.row import Row

RUN_FILE, EPISODES_FILE, INDEX_FILE, METRICS_FILE, IMAGES = (
    "run.json",
    "episodes.jsonl.zst",
    "index.jsonl",
    "metrics.json",
    "images",
)

_Read = TypeVar("_Read")


class Run:
    """A run that was recorded, or is being recorded: its rows are in memory, its episodes are read one by one.

    Args:
        path: Folder of the run; or a file of episodes that ``gem run`` wrote.
        read: Whether the rows are read at once, or by ``refresh``.
        joint: Whether an episode of several agents has one row, which ``record`` reads; else each seat has its own.

    Raises:
        ArgumentError: There is no run.
        EpisodeFileError: It cannot be read.
    """

    def __init__(self, path: str | Path, *, read: bool = True, joint: bool = False) -> None:
        self.path = Path(path)
        self.is_folder = self.path.is_dir()
        self._episodes = self.path / EPISODES_FILE if self.is_folder else self.path
        self._index = self.path / INDEX_FILE
        self._source = self._index if self.is_folder else self.path
        """The file that rows are read from: without an index, that of the episodes."""
        self._joint = joint
        self._read = 0
        """Bytes of the index, or of the file of episodes or frames, that have been read."""
        self._lines = 0
        self._latest: dict[object, Row] = {}
        self.superseded: list[Row] = []
        """Earlier records of episodes that were run again."""
        self.damage: dict[int, str] = {}
        """Why a line of the index, or of the file, holds no whole episode, by its number."""
        if not self.path.exists():
            raise ArgumentError(f"there is no run {path}: give the folder that 'gem eval' wrote, or a file of episodes")
        if not self.is_folder and not self.path.is_file():
            raise EpisodeFileError(f"cannot read {path}: it is no regular file; write it to one first")
        if self.is_folder and not (self.path / RUN_FILE).exists():
            inside = sorted(self.path.glob(f"*/{RUN_FILE}"), key=lambda file: file.stat().st_mtime)
            hint = f"; name one of the runs in it, as {inside[-1].parent}" if inside else ""
            raise ArgumentError(f"{path} is no run: there is no {RUN_FILE} in it{hint}")
        if read:
            self.refresh(torn=not self.is_folder)

    @property
    def name(self) -> str:
        """Name of the folder, or of the file without its ending."""
        return self.path.resolve().name if self.is_folder else self.path.stem

    @property
    def info(self) -> dict[str, Any]:
        """What ``run.json`` says, read anew; empty for a file of episodes.

        Raises:
            EpisodeFileError: It cannot be read.
        """
        return read_info(self.path) if self.is_folder else {}

    @property
    def rows(self) -> list[Row]:
        """The episodes in the order in which they were first written; of those that were run again, the latest."""
        rows = list(self._latest.values())
        return rows if self._joint or self.is_folder else [each for row in rows for each in row.apart()]

    @property
    def damaged(self) -> int:
        """How many lines of the index, or of the file, could not be read."""
        return len(self.damage)

    @property
    def share_read(self) -> float:
        """How much of the run is read, from 0 to 1."""
        with suppress(OSError):
            return min(1.0, self._read / (self._source.stat().st_size or 1))
        return 1.0

    def refresh(self, most: int | None = None, *, torn: bool = False) -> list[Row]:
        """Read what was written since; return the new rows.

        A file that has become shorter is another run's, and is read from its beginning.

        Args:
            most: Read so many lines and stop; the next call goes on. None reads all.
            torn: Whether a last line without its end, which may still be written to, is read as well.

        Raises:
            EpisodeFileError: The run cannot be read.
        """
        is_index = self.is_folder and self._index.exists()
        source = self._index if is_index else self._episodes
        if self._read and (source != self._source or not source.exists() or source.stat().st_size < self._read):
            self._latest.clear()
            self.superseded.clear()
            self.damage.clear()
            self._read = self._lines = 0
        self._source = source
        found = []
        for number, offset, content in itertools.islice(self._new_lines(torn), most):
            try:
                row = Row.from_line(content) if is_index else Row.of(unpack(content), number, offset, len(content))
            except EpisodeFileError as error:
                is_cut = not self.is_folder and not content.endswith(b"\n")
                note = ". The line is cut off: the writer was interrupted, or is still at it" if is_cut else ""
                self.damage[number] = f"{error}{note}"
                continue
            found.append(row)
            # In a file, several runs may have been appended, and their keys are the same.
            key = (row.key, row.epoch) if self.is_folder else number
            earlier = self._latest.get(key, row)
            if earlier != row:
                self.superseded.append(earlier)
            self._latest[key] = row
        return found

    def _new_lines(self, torn: bool) -> Iterator[tuple[int, int, bytes]]:
        """Yield what has been added, each with its number and where it begins: lines, or frames without an index."""
        try:
            with self._source.open("rb") as file:
                if self.is_folder and self._source == self._episodes:
                    for offset, frame in frames(file, self._read):
                        self._lines, self._read = self._lines + 1, offset + len(frame)
                        yield self._lines, offset, frame
                    return
                file.seek(self._read)
                for line in file:
                    if line.endswith(b"\n") or torn:
                        offset = self._read
                        self._lines, self._read = self._lines + 1, offset + len(line)
                        if line.strip():
                            yield self._lines, offset, line
        except FileNotFoundError:
            return  # no episode has ended
        except OSError as error:
            raise EpisodeFileError(f"cannot read {self._source}: {error.strerror or error}") from error

    def line(self, row: Row) -> Any:
        """Return the record of an episode as it was written, with what stands under ``"evaluation"``.

        Raises:
            EpisodeFileError: It is not there, or is damaged.
        """
        line = self.line_bytes(row)
        try:
            return unpack(line)
        except EpisodeFileError as error:
            raise self._damaged_at(row, error) from error

    def line_bytes(self, row: Row) -> bytes:
        """Return the line of an episode as it was written.

        Raises:
            EpisodeFileError: It is not there, or is damaged.
        """
        try:
            with self._episodes.open("rb") as file:
                return decompressed(os.pread(file.fileno(), row.length, row.offset))
        except OSError as error:
            raise EpisodeFileError(f"cannot read {self._episodes}: {error.strerror or error}") from error
        except EpisodeFileError as error:
            raise self._damaged_at(row, error) from error

    def _damaged_at(self, row: Row, error: EpisodeFileError) -> EpisodeFileError:
        return EpisodeFileError(f"{self._episodes}, episode {row.number}: {error}")

    def record(self, row: Row) -> Record:
        """Return the episode of a row, also one of several agents; images stay names of files.

        Raises:
            EpisodeFileError: It is not there, or is damaged.
        """
        return record_from_dict(self.line(row))

    def episode(self, row: Row, *, images: bool = False) -> Episode:
        """Return the episode of a row.

        Args:
            row: One of ``rows``.
            images: Read the images; without, the record of an image file stands in the place of each.

        Raises:
            EpisodeFileError: It is not there, or is damaged.
        """
        if row.seat is None:
            return Episode.from_dict(self.line(row), self.images if images else None)
        joint = record_from_dict(self.line(row), self.images if images else None)
        if isinstance(joint, Episode) or row.seat not in joint.seats:
            raise EpisodeFileError(f"{self._episodes}, episode {row.number}: it has no seat {row.seat!r}")
        return joint.seats[row.seat]

    def episodes(self) -> Iterator[tuple[Row, Episode]]:
        """Yield the episodes as they count, each with its row; see ``intact``."""
        return self.intact(self.rows, self.episode)

    def intact(self, rows: Iterable[Row], read: Callable[[Row], _Read]) -> Iterator[tuple[Row, _Read]]:
        """Yield rows, each with what is read of its episode; a damaged one is left out, and noted in ``damage``."""
        for row in rows:
            try:
                found = read(row)
            except EpisodeFileError as error:
                self.damage[row.number] = str(error)
            else:
                yield row, found

    def row(self, number: int) -> Row:
        """Return the row of an episode by its number.

        Raises:
            ArgumentError: There is none.
            EpisodeFileError: The line holds no whole episode.
        """
        for row in self.rows:
            if row.number == number:
                return row
        if number in self.damage:
            raise EpisodeFileError(f"{self.path}, line {number} holds no whole episode: {self.damage[number]}")
        has = f"which has {len(self._latest):,} episodes"
        raise ArgumentError(f"no episode {number} in {self.path}, {has}. Run 'gem show {self.path}'")

    @property
    def images(self) -> ImageFolder:
        """Folder of the images."""
        return ImageFolder(self.path / IMAGES) if self.is_folder else ImageFolder.beside(self.path)


def open_run(path: str | Path) -> Run:
    """Return a run to read: a folder that ``gem eval`` wrote, or a file that ``gem run`` wrote; see ``Run``."""
    return Run(path)


def read_info(path: Path) -> dict[str, Any]:
    """Return what ``run.json`` says in the folder of a run.

    Raises:
        EpisodeFileError: It cannot be read.
    """
    file = path / RUN_FILE
    try:
        content = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise EpisodeFileError(f"cannot read {file}: {error}") from error
    if not isinstance(content, dict):
        raise EpisodeFileError(f"cannot read {file}: it holds no JSON object")
    return content
