"""Pages that are written whole or not at all, and new folders of runs."""

from __future__ import annotations

import time
from pathlib import Path

from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.records import whole_file


def write_page(path: Path, page: str) -> None:
    """Write a page whole or not at all, in a folder that need not be there yet.

    Raises:
        ArgumentError: It cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as file:
            file.write(page.encode("utf-8"))
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
