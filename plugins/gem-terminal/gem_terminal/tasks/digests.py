"""The hash of a task folder, which is the version of the task, and the checks of what is in it."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from gem_terminal.errors import TaskError

_MOST_ENTRIES = 200_000
_BLOCK = 1 << 20


def scan(folder: Path) -> str:
    """Check all of a folder, and return the hash of all of it: names, kinds, permissions, contents, targets of links.

    Args:
        folder: Absolute, without links.

    Raises:
        TaskError: It cannot be read, has a link that leads out of it, or what is neither a file, a folder nor a link.
    """
    total = hashlib.sha256()
    for relative, status in _entries(folder):
        path = folder / relative
        kind = status.st_mode
        name = os.fsencode(relative)
        total.update(b"%d %o %d " % (len(name), kind, status.st_size if stat.S_ISREG(kind) else 0) + name)
        try:
            if stat.S_ISLNK(kind):
                total.update(os.fsencode(path.readlink()) + b"\0")
            elif stat.S_ISREG(kind):
                total.update(_file_hash(path))
        except OSError as error:
            raise TaskError(f"{path}: cannot be read: {error.strerror}.") from error
    return total.hexdigest()


def _file_hash(path: Path) -> bytes:
    # Not blocking, not following: the folder may have changed since it was listed.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        content = hashlib.sha256()
        while block := os.read(descriptor, _BLOCK):
            content.update(block)
        return content.digest()
    finally:
        os.close(descriptor)


def _entries(folder: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Yield all below a folder, sorted, with their status; links are not followed."""
    count = 0
    waiting = [""]
    while waiting:
        relative = waiting.pop()
        try:
            with os.scandir(folder / relative) as opened:
                found = sorted(opened, key=lambda entry: entry.name)
            listed = [(entry, entry.stat(follow_symlinks=False)) for entry in found]
        except OSError as error:
            raise TaskError(f"{folder / relative}: cannot be read: {error.strerror}.") from error
        for entry, status in listed:
            count += 1
            if count > _MOST_ENTRIES:
                raise TaskError(f"{folder}: has more than {_MOST_ENTRIES:,} files; expected a task folder.")
            below = os.path.join(relative, entry.name)
            _check(folder, below, status)
            yield below, status
            if stat.S_ISDIR(status.st_mode):
                waiting.append(below)


def _check(folder: Path, relative: str, status: os.stat_result) -> None:
    path = folder / relative
    if stat.S_ISLNK(status.st_mode):
        if not Path(os.path.realpath(path)).is_relative_to(folder):
            raise TaskError(
                f"{path}: is a link to {os.readlink(path)!r}, out of {folder}; put a copy in its place, or make the "
                "link in the Dockerfile."
            )
    elif not stat.S_ISDIR(status.st_mode) and not stat.S_ISREG(status.st_mode):
        raise TaskError(f"{path}: is neither a file nor a folder; remove it.")
