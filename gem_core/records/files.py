"""Files of episodes: one JSON object on each line, with images as side files in a folder beside it."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

from gem_core.errors import EpisodeFileError
from gem_core.records.episode import Episode
from gem_core.records.joint import Record, record_from_dict
from gem_core.records.plain_json import ImageFolder


class EpisodeFileWarning(UserWarning):
    """A line of a file of episodes was passed over; the message says which and why."""


class EpisodeWriter:
    """Writes episodes to a file as they finish, each line at once.

    Args:
        path: The file; folders above it are made.
        append: Append to the file, instead of replacing it with the first episode.

    Raises:
        EpisodeFileError: The file cannot be written.
    """

    def __init__(self, path: str | Path, *, append: bool = False) -> None:
        self.path = Path(path)
        self.count = 0
        self._images = ImageFolder.beside(self.path)
        self._append = append
        self._to_empty = not append
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            torn = append and _is_torn(self.path)
            # Without a buffer: a line is one system call, which Ctrl-C cannot cut in two.
            self._file = self.path.open("ab", buffering=0)
        except OSError as error:
            raise EpisodeFileError(f"cannot write {self.path}: {error.strerror or error}") from error
        if torn:
            self._write(b"\n")

    def write(self, episode: Record) -> None:
        """Write one episode, of one agent or of several."""
        # ASCII only: text of a model may hold lone surrogates, which UTF-8 cannot.
        try:
            record = episode.to_dict(self._images)
        except OSError as error:
            raise EpisodeFileError(f"cannot write the images of {self.path}: {error.strerror or error}") from error
        line = json.dumps(record, ensure_ascii=True, allow_nan=False)
        self._write(line.encode("ascii") + b"\n")
        self.count += 1

    def _write(self, data: bytes) -> None:
        try:
            self._empty()
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            raise EpisodeFileError(f"cannot write {self.path}: {error.strerror or error}") from error

    def _empty(self) -> None:
        if self._to_empty and os.fstat(self._file.fileno()).st_size:
            self._file.truncate(0)
        self._to_empty = False

    def discard(self) -> None:
        """Close the file of a run that wrote nothing: earlier content stays, and an empty file is removed."""
        self._to_empty = False
        self.close()
        with suppress(OSError):
            if not self._append and self.path.is_file() and not self.path.stat().st_size:
                self.path.unlink()

    def close(self) -> None:
        """Close the file; calling it again does nothing."""
        if not self._file.closed:
            self._empty()
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def write_episodes(path: str | Path, episodes: Iterable[Record], *, append: bool = False) -> int:
    """Write episodes to a file and return their number; see ``EpisodeWriter``."""
    with EpisodeWriter(path, append=append) as writer:
        for episode in episodes:
            writer.write(episode)
        return writer.count


def read_episodes(path: str | Path, *, images: bool = True) -> Iterator[Episode]:
    """Yield the whole episodes of a file, one at a time; of several agents, the episode of each seat.

    Args and errors are those of ``read_records``.
    """
    for record in read_records(path, images=images):
        yield from [record] if isinstance(record, Episode) else record


def read_records(path: str | Path, *, images: bool = True) -> Iterator[Record]:
    """Yield the whole records of a file, one at a time: an ``Episode``, or a ``JointEpisode`` of several agents.

    A line that is cut off or damaged is passed over, with an ``EpisodeFileWarning`` that names it.

    Args:
        path: The file.
        images: Read the images; without, the record of an image file stands in the place of each.

    Raises:
        EpisodeFileError: The file cannot be read.
    """
    path = Path(path)
    for line in episode_lines(path, images=images):
        if line.episode is not None:
            yield line.episode
        else:
            cut = "" if line.text.endswith(b"\n") else " The line is cut off: the writer was interrupted."
            warnings.warn(
                f"{path}, line {line.number}: passed over, because {line.damage}.{cut}",
                EpisodeFileWarning,
                stacklevel=2,
            )


class EpisodeLine(NamedTuple):
    """One line of a file of episodes.

    Args:
        number: From 1.
        text: As it stands there.
        episode: What it holds; None where it is damaged.
        damage: What is wrong with it.
    """

    number: int
    text: bytes
    episode: Record | None
    damage: EpisodeFileError | None = None


def episode_lines(path: str | Path, *, images: bool = False) -> Iterator[EpisodeLine]:
    """Yield the lines of a file of episodes that are not blank; see ``read_episodes``.

    Raises:
        EpisodeFileError: The file cannot be read.
    """
    path = Path(path)
    folder = ImageFolder.beside(path) if images else None
    try:
        with path.open("rb") as file:
            for number, text in enumerate(file, start=1):
                if text.strip():
                    yield _line(number, text, folder)
    except OSError as error:
        raise EpisodeFileError(f"cannot read {path}: {error.strerror or error}") from error


def _line(number: int, text: bytes, images: ImageFolder | None) -> EpisodeLine:
    try:
        return EpisodeLine(number, text, record_from_dict(_parsed(text), images))
    except EpisodeFileError as error:
        return EpisodeLine(number, text, None, error)


def _parsed(line: bytes) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as error:
        raise EpisodeFileError(f"it is no valid JSON ({error})") from error


def _is_torn(path: Path) -> bool:
    if not path.exists() or path.stat().st_size == 0:
        return False
    with path.open("rb") as file:
        file.seek(-1, 2)
        return file.read(1) != b"\n"
