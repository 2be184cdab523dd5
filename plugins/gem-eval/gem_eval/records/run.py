"""``Run``: reads a run, also while it grows."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gem_core import Episode
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import ImageFolder
from gem_eval.records.frames import frames, unpack
from gem_eval.records.row import Row

RUN_FILE, EPISODES_FILE, INDEX_FILE, METRICS_FILE, IMAGES = (
    "run.json",
    "episodes.jsonl.zst",
    "index.jsonl",
    "metrics.json",
    "images",
)


class Run:
    """A run that was recorded, or is being recorded: its rows are in memory, its episodes are read one by one.

    Args:
        path: Folder of the run; or a file of episodes that ``gem run`` wrote.

    Raises:
        ArgumentError: There is no run.
        EpisodeFileError: It cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.is_folder = self.path.is_dir()
        self._episodes = self.path / EPISODES_FILE if self.is_folder else self.path
        self._index = self.path / INDEX_FILE
        self._read = 0
        """Bytes of the index, or of the file of episodes, that have been read."""
        self._read_frames = 0
        """Bytes of the frames that have been read, where the index is gone."""
        self._lines = 0
        self._latest: dict[tuple[str, int], Row] = {}
        self.superseded: list[Row] = []
        """Earlier records of episodes that were run again."""
        self.damaged = 0
        """Lines of the index, or of the file, that could not be read."""
        if not self.path.exists():
            raise ArgumentError(f"there is no run {path}: give the folder that 'gem eval' wrote, or a file of episodes")
        if self.is_folder and not (self.path / RUN_FILE).exists():
            raise ArgumentError(f"{path} is no run: there is no {RUN_FILE} in it")
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

    def refresh(self) -> list[Row]:
        """Read what was written since; return the new rows."""
        new = self._new_index_rows() if self.is_folder else self._new_file_rows()
        found = []
        for row in new:
            earlier = self._latest.get((row.key, row.epoch), row)
            if earlier != row:
                self.superseded.append(earlier)
            self._latest[row.key, row.epoch] = row
            found.append(row)
        return found

    def line(self, row: Row) -> Any:
        """Return the record of an episode as it was written, with what stands under ``"evaluation"``.

        Raises:
            EpisodeFileError: It is not there, or is damaged.
        """
        try:
            with self._episodes.open("rb") as file:
                return unpack(os.pread(file.fileno(), row.length, row.offset))
        except OSError as error:
            raise EpisodeFileError(f"cannot read {self._episodes}: {error.strerror or error}") from error
        except EpisodeFileError as error:
            raise EpisodeFileError(f"{self._episodes}, episode {row.number}: {error}") from error

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

    def _new_index_rows(self) -> Iterator[Row]:
        if not self._index.exists():
            yield from self._new_frame_rows()
        for _, line in self._new_lines(self._index):
            try:
                yield Row.from_dict(json.loads(line))
            except (ValueError, RecursionError, EpisodeFileError):
                self.damaged += 1

    def _new_frame_rows(self) -> Iterator[Row]:
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

    def _new_file_rows(self) -> Iterator[Row]:
        for offset, line in self._new_lines(self._episodes):
            self._lines += 1
            try:
                yield Row.of(unpack(line), self._lines, offset, len(line))
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
