"""Files that are written whole or not at all, and new folders of runs."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import BinaryIO

from gem_core.errors import ArgumentError, EpisodeFileError


def write_whole(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a file whole or not at all; see ``whole_file``."""
    with whole_file(path, mode) as file:
        file.write(content)


@contextmanager
def whole_file(path: Path, mode: int = 0o666) -> Iterator[BinaryIO]:
    """Open a file to write; it gets its name only when the block ends without an error.

    Args:
        path: The file.
        mode: Permissions of the file, less those that the user's umask takes away.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with open(unfinished, "xb", opener=partial(os.open, mode=mode)) as file:
            yield file
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_page(path: Path, page: str) -> None:
    """Write a page whole or not at all, in a folder that need not be there yet.

    Raises:
        ArgumentError: It cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, page.encode("utf-8"))
    except OSError as error:
        raise ArgumentError(f"cannot write {path}: {error.strerror or error}") from error


def new_run_folder(name: str) -> Path:
    """Make a folder in ``runs/`` with a name and the time, and return it.

    Raises:
        EpisodeFileError: It cannot be made.
    """
    stem = f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
    for number in range(1, 1000):
        path = Path("runs") / (stem if number == 1 else f"{stem}-{number}")
        with suppress(FileExistsError):
            try:
                path.mkdir(parents=True)
            except FileExistsError:
                raise
            except OSError as error:
                raise EpisodeFileError(f"cannot write {path}: {error.strerror or error}") from error
            return path
    raise EpisodeFileError(f"there is no free name for a folder in runs/ like {stem}")
