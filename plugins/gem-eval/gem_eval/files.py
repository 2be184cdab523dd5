"""Files that are written whole or not at all, and new folders of runs."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from gem_core.errors import ArgumentError, EpisodeFileError


def write_whole(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; see ``whole_file``."""
    with whole_file(path) as file:
        file.write(content)


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file to write; it gets its name only when the block ends without an error."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with unfinished.open("xb") as file:
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
    number = 1
    while True:
        path = Path("runs") / (stem if number == 1 else f"{stem}-{number}")
        try:
            path.mkdir(parents=True)
            return path
        except FileExistsError:
            number += 1
        except OSError as error:
            raise EpisodeFileError(f"cannot write {path}: {error.strerror or error}") from error
