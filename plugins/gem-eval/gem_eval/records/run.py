"""``Run``: reads a run, also while it grows."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

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

_LINES_AT_ONCE = 500


class Run:
    """A run that was recorded, or is being recorded: its rows are in memory, its episodes are read one by one.

    Args:
        path: Folder of the run; or a file of episodes that ``gem run`` wrote.
        read: Whether the rows are read at once, or by ``refresh``.
        joint: Whether episodes of several agents in a file have a row, which only ``record`` reads; else their lines
            count as damaged.

    Raises:
        ArgumentError: There is no run.
        EpisodeFileError: It cannot be read.
    """

    def __init__(self, path: str | Path, *, read: bool = True, joint: bool = False) -> None:
        self.path = Path(path)
        self.is_folder = self.path.is_dir()
        self._episodes = self.path / EPISODES_FILE if self.is_folder else self.path
        self._index = self.path / INDEX_FILE
        self._joint = joint
        self._read = 0
        """Bytes of the index, or of the file of episodes, that have been read."""
        self._read_frames = 0
        """Bytes of the frames that have been read, where the index is gone."""
        self._lines = 0
        self._latest: dict[object, Row] = {}
        self.superseded: list[Row] = []
        """Earlier records of episodes that were run again."""
        self.damaged = 0
        """Lines of the index, or of the file, that could not be read."""
        if not self.path.exists():
            raise ArgumentError(f"there is no run {path}: give the folder that 'gem eval' wrote, or a file of episodes")
        if self.is_folder and not (self.path / RUN_FILE).exists():
            inside = sorted(self.path.glob(f"*/{RUN_FILE}"), key=lambda file: file.stat().st_mtime)
            hint = f"; name one of the runs in it, as {inside[-1].parent}" if inside else ""
            raise ArgumentError(f"{path} is no run: there is no {RUN_FILE} in it{hint}")
        if read:
            self.refresh()

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
        return list(self._latest.values())

    @property
    def share_read(self) -> float:
        """How much of the run is read, from 0 to 1."""
        with suppress(OSError):
            return min(1.0, self._read / ((self._index if self.is_folder else self._episodes).stat().st_size or 1))
        return 1.0

    def refresh(self, most: int | None = None) -> list[Row]:
        """Read what was written since; return the new rows.

        A file that has become shorter is another run's, and is read from its beginning.

        Args:
            most: Read so many lines and stop; the next call goes on. None reads all.

        Raises:
            EpisodeFileError: The run cannot be read.
        """
        path = self._index if self.is_folder else self._episodes
        if self._read and (not path.exists() or path.stat().st_size < self._read):
            self._latest.clear()
            self.superseded.clear()
            self._read = self._read_frames = self._lines = self.damaged = 0
        lines = itertools.islice(self._new_lines(path), most)
        if not self.is_folder:
            found = list(self._file_rows(lines))
        else:
            found = list(self._index_rows(lines) if self._index.exists() else self._frame_rows())
        for row in found:
            # In a file, several runs may have been appended, and their keys are the same.
            key = (row.key, row.epoch) if self.is_folder else row.number
            earlier = self._latest.get(key, row)
            if earlier != row:
                self.superseded.append(earlier)
            self._latest[key] = row
        return found

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
        return Episode.from_dict(self.line(row), self.images if images else None)

    def episodes(self) -> Iterator[tuple[Row, Episode]]:
        """Yield the episodes as they count, each with its row."""
        for row in self.rows:
            yield row, self.episode(row)

    def row(self, number: int) -> Row:
        """Return the row of an episode by its number.

        Raises:
            ArgumentError: There is none.
        """
        for row in self._latest.values():
            if row.number == number:
                return row
        raise ArgumentError(f"no episode {number} in {self.path}, which has {len(self._latest)}; run 'gem show' on it")

    @property
    def images(self) -> ImageFolder:
        """Folder of the images."""
        return ImageFolder(self.path / IMAGES) if self.is_folder else ImageFolder.beside(self.path)

    def _index_rows(self, lines: Iterator[tuple[int, bytes]]) -> Iterator[Row]:
        # To parse many lines as one list takes half the time.
        while chunk := [line for _, line in itertools.islice(lines, _LINES_AT_ONCE)]:
            try:
                records = json.loads(b"[" + b",".join(chunk) + b"]")
            except (ValueError, RecursionError):
                records = []
            for record in records if len(records) == len(chunk) else map(_parsed, chunk):
                try:
                    yield Row.from_dict(record)
                except EpisodeFileError:
                    self.damaged += 1

    def _frame_rows(self) -> Iterator[Row]:
        """Yield the rows that the frames tell, where there is no index."""
        try:
            with self._episodes.open("rb") as file:
                for offset, frame in frames(file, self._read_frames):
                    self._read_frames = offset + len(frame)
                    try:
                        row = Row.of(unpack(frame), self._lines + 1, offset, len(frame))
                    except EpisodeFileError:
                        self.damaged += 1
                        continue
                    self._lines += 1
                    yield row
        except FileNotFoundError:
            return  # no episode has ended
        except OSError as error:
            raise EpisodeFileError(f"cannot read {self._episodes}: {error.strerror or error}") from error

    def _file_rows(self, lines: Iterator[tuple[int, bytes]]) -> Iterator[Row]:
        for offset, line in lines:
            self._lines += 1
            try:
                yield Row.of(unpack(line), self._lines, offset, len(line), joint=self._joint)
            except EpisodeFileError:
                self.damaged += 1

    def _new_lines(self, path: Path) -> Iterator[tuple[int, bytes]]:
        """Yield the whole lines that have been added to a file, each with its offset."""
        try:
            with path.open("rb") as file:
                file.seek(self._read)
                for line in file:
                    if not line.endswith(b"\n"):
                        return  # it is still being written
                    offset, self._read = self._read, self._read + len(line)
                    if line.strip():
                        yield offset, line
        except FileNotFoundError:
            return  # no episode has ended
        except OSError as error:
            raise EpisodeFileError(f"cannot read {path}: {error.strerror or error}") from error


def open_run(path: str | Path) -> Run:
    """Return a run to read: a folder that ``gem eval`` wrote, or a file that ``gem run`` wrote; see ``Run``."""
    return Run(path)


def _parsed(line: bytes) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


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
