"""Files of episodes: one JSON object on each line, with images as side files in a folder beside it."""

from __future__ import annotations

import json
import os
import shutil
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self

from gem_core.errors import EpisodeFileError
from gem_core.records.episode import Episode
from gem_core.records.joint import Record, record_from_dict
from gem_core.records.plain_json import ImageFolder

_continued: set[Path] = set()
"""Files that runs of this process have been resumed from, and that nobody has written to since."""


class EpisodeFileWarning(UserWarning):
    """A line of a file of episodes was passed over; the message says which and why."""


class EpisodeWriter:
    """Writes episodes to a file as they finish, each line at once. The file is locked until it is closed.

    Args:
        path: The file; folders above it are made.
        append: Append to the file, instead of replacing it with the first episode. A file that a run was resumed from,
            by ``rollout(resume=path)``, is appended to in any case.

    Raises:
        EpisodeFileError: The file cannot be written, or is being written.
    """

    def __init__(self, path: str | Path, *, append: bool = False) -> None:
        self.path = Path(path)
        self.count = 0
        self._images = ImageFolder.beside(self.path)
        self._append = append
        self._begun = False
        with _named(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = _opened(self.path)

    def write(self, episode: Record) -> None:
        """Write one episode, of one agent or of several."""
        with _named(self.path):
            # ASCII only: text of a model may hold lone surrogates, which UTF-8 cannot.
            line = json.dumps(episode.to_dict(self._images), allow_nan=False).encode("ascii") + b"\n"
            self._begin()
            if not self.count and _is_torn(self.path):
                line = b"\n" + line
            while line:
                line = line[self._file.write(line) :]
        self.count += 1

    def rewrite(self, lines: Iterable[bytes]) -> None:
        """Replace the content of the file by some lines, atomically; images stay.

        Raises:
            EpisodeFileError: The file cannot be written; it has not been changed.
        """
        with _named(self.path):
            with whole_file(self.path) as file:
                file.writelines(line.rstrip(b"\n") + b"\n" for line in lines)
            self._file.close()
            self._file = _opened(self.path)

    def _begin(self) -> None:
        """Empty the file before the first line, unless it is appended to."""
        if not self._begun:
            self._begun = True
            kept = self._append or self.path.resolve() in _continued
            if not kept and os.fstat(self._file.fileno()).st_size:
                self._file.truncate(0)

    def discard(self) -> None:
        """Close the file of a run that wrote nothing: earlier content stays, and an empty file is removed."""
        self._begun = True
        with suppress(OSError):
            if not self._append and self.path.is_file() and not self.path.stat().st_size:
                self.path.unlink()
        self.close()

    def close(self) -> None:
        """Close the file; calling it again does nothing."""
        if not self._file.closed:
            self._begin()
            _continued.discard(self.path.resolve())
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Raise the errors of the system as errors of this file."""
    try:
        yield
    except OSError as error:
        raise EpisodeFileError(f"cannot write {path}: {error.strerror or error}") from error


def _opened(path: Path) -> BinaryIO:
    """Open a file to append to it, and lock it; the lock ends when the file is closed, or with the process.

    Raises:
        EpisodeFileError: Another writer has the file.
    """
    # Without a buffer: a line is one system call, which Ctrl-C cannot cut in two.
    file = path.open("ab", buffering=0)
    try:
        import fcntl

        if path.is_file():  # and no pipe or device
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise EpisodeFileError(
            f"cannot write {path}: it is being written already; wait until that has ended, or name another file"
        ) from None
    except (ImportError, OSError):
        pass  # a system, or a file system, without such locks
    return file


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file to write; it replaces what stands under its name when the block ends without an error.

    Readers see the old file or the new one, and a killed process leaves the old one. Its mode stays, and a symbolic
    link stays a link.

    Raises:
        OSError: The file cannot be written.
    """
    path = path.resolve()
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            yield file
        with suppress(FileNotFoundError):
            shutil.copymode(path, partial)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def continue_file(path: str | Path) -> None:
    """Let the writer of a file, the present one or the next, append to it, since a run goes on with its episodes."""
    _continued.add(Path(path).resolve())


def write_episodes(path: str | Path, episodes: Iterable[Record], *, append: bool = False) -> int:
    """Write episodes to a file and return their number; see ``EpisodeWriter``."""
    with EpisodeWriter(path, append=append) as writer:
        for episode in episodes:
            writer.write(episode)
        return writer.count


def read_episodes(path: str | Path, *, images: bool = True) -> Iterator[Episode]:
    """Yield the whole episodes of a file, one at a time; of several agents, the episode of each seat.

    It takes the arguments of ``read_records``, and raises its errors.
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
        episode: Its episode; None if the line is damaged.
        damage: The damage, in words.
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
        return EpisodeLine(number, text, record_from_dict(json.loads(text), images))
    except EpisodeFileError as error:
        return EpisodeLine(number, text, None, error)
    except (ValueError, RecursionError) as error:
        return EpisodeLine(number, text, None, EpisodeFileError(f"it is no valid JSON ({error})"))


def _is_torn(path: Path) -> bool:
    if not path.stat().st_size:
        return False
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) != b"\n"
