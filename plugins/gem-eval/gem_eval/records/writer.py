"""``RunWriter``: writes a run, episode by episode."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from gem_core import Episode
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import ImageFolder, to_plain, whole_file
from gem_eval.records.frames import frame_at, frames, pack, unpack
from gem_eval.records.row import Row
from gem_eval.records.run import EPISODES_FILE, IMAGES, INDEX_FILE, METRICS_FILE, RUN_FILE


class RunWriter:
    """Appends episodes to the folder of a run; a run that was killed is mended first.

    Args:
        path: The folder; it is made where it is not there.

    Raises:
        ArgumentError: This run is being written already.
        EpisodeFileError: The folder cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._images = ImageFolder(self.path / IMAGES)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            # Without a buffer: each frame and each line is one system call, which Ctrl-C cannot cut in two.
            self._episodes = open(self.path / EPISODES_FILE, "ab", buffering=0)  # noqa: SIM115 - closed by close()
            try:
                fcntl.flock(self._episodes, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self._episodes.close()
                raise ArgumentError(f"the run {path} is being written already; wait for it, or give --out") from None
            self._index = open(self.path / INDEX_FILE, "ab", buffering=0)  # noqa: SIM115
            self._count = self._mend()
        except OSError as error:
            raise EpisodeFileError(f"cannot write the run {path}: {error.strerror or error}; give --out") from error

    def write_info(self, info: Mapping[str, Any]) -> None:
        """Write ``run.json`` whole."""
        self._write_json(RUN_FILE, info)

    def write_metrics(self, metrics: Mapping[str, Any]) -> None:
        """Write ``metrics.json`` whole."""
        self._write_json(METRICS_FILE, metrics)

    def write(self, episode: Episode, evaluation: Mapping[str, Any]) -> Row:
        """Append an episode.

        Args:
            episode: The episode.
            evaluation: What its record says of it besides: see ``Row``.

        Raises:
            EpisodeFileError: It cannot be written.
        """
        try:
            record = episode.to_dict(self._images)
            frame = pack({**record, "evaluation": to_plain(dict(evaluation))})
            offset = self._episodes.seek(0, os.SEEK_END)
            row = Row.of_episode(episode, evaluation, self._count + 1, offset, len(frame))
            _write_all(self._episodes, frame)
            self._append(row)
        except OSError as error:
            raise EpisodeFileError(f"cannot write the run {self.path}: {error.strerror or error}") from error
        return row

    def close(self) -> None:
        """Close the files; calling it again does nothing."""
        self._episodes.close()
        self._index.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _append(self, row: Row) -> None:
        line = json.dumps(row.to_dict(), ensure_ascii=True, allow_nan=False)
        _write_all(self._index, line.encode("ascii") + b"\n")
        self._count += 1

    def _mend(self) -> int:
        """Cut off what a killed process wrote by half, and index what it had not; return the number of episodes.

        What is damaged before a whole frame stays where it is, and is passed over.
        """
        count, indexed, kept = self._whole_index()
        os.ftruncate(self._index.fileno(), kept)
        self._count = count
        end = indexed
        with (self.path / EPISODES_FILE).open("rb") as file:
            for offset, frame in frames(file, indexed):
                try:
                    row = Row.of(unpack(frame), self._count + 1, offset, len(frame))
                except EpisodeFileError:
                    continue
                self._append(row)
                end = offset + len(frame)
        os.ftruncate(self._episodes.fileno(), end)
        return self._count

    def _whole_index(self) -> tuple[int, int, int]:
        """Return how many lines of the index hold, the end of the last frame that they name, and their length."""
        size = os.fstat(self._episodes.fileno()).st_size
        count = end = kept = 0
        with (self.path / INDEX_FILE).open("rb") as file, (self.path / EPISODES_FILE).open("rb") as episodes:
            for line in file:
                try:
                    row = Row.from_line(line)
                except EpisodeFileError:
                    break
                if not line.endswith(b"\n") or row.offset < end or row.offset + row.length > size:
                    break
                if row.offset > end and len(frame_at(episodes, row.offset) or b"") != row.length:
                    break  # it does not stand behind a frame that was damaged and passed over
                count, end, kept = count + 1, row.offset + row.length, kept + len(line)
        return count, end, kept

    def _write_json(self, name: str, content: Mapping[str, Any]) -> None:
        text = json.dumps(to_plain(dict(content)), ensure_ascii=True, indent=1)
        try:
            with whole_file(self.path / name) as file:
                file.write(text.encode("ascii") + b"\n")
        except OSError as error:
            raise EpisodeFileError(f"cannot write {self.path / name}: {error.strerror or error}") from error


def _write_all(file: Any, data: bytes) -> None:
    while data:
        data = data[file.write(data) :]
