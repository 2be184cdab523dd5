"""Files of a view, reached from its root folder step by step, so that no link is ever followed."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from typing import Any

FOLDER_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_MOST_FILES = 20_000
_MOST_LOOKED_AT = 200_000
_MOST_DEPTH = 100
_PIECE = 1 << 20


class Trash:
    """A folder beside the roots that what is to be removed is moved to: at once, whatever its size."""

    def __init__(self, folder: str) -> None:
        self.folder = folder
        self.count = 0

    def take(self, name: str, parent: int) -> None:
        """Move an entry of an open folder here; what is not there is no error."""
        self.count += 1
        with contextlib.suppress(FileNotFoundError):
            os.rename(name, f"{self.folder}/{os.getpid()}-{self.count}", src_dir_fd=parent)


def parts_of(path: str) -> list[str]:
    """Return the names that an absolute path is made of.

    Raises:
        ValueError: It is not absolute, or leads upwards.
    """
    parts = [part for part in path.split("/") if part not in ("", ".")]
    if not path.startswith("/") or ".." in parts or "\0" in path:
        raise ValueError(f"{path!r} is not an absolute path without '..'")
    return parts


def open_folder(root: str, parts: list[str], trash: Trash | None) -> int:
    """Open a folder below a root; with ``trash`` it is made, and what is in its way, as a link, removed.

    Raises:
        OSError: It is not there, or cannot be made.
    """
    current = os.open(root, FOLDER_FLAGS)
    try:
        for part in parts:
            following = _step(current, part, trash)
            os.close(current)
            current = following
    except BaseException:
        os.close(current)
        raise
    return current


def _step(parent: int, name: str, trash: Trash | None) -> int:
    for _ in range(10):
        try:
            return os.open(name, FOLDER_FLAGS, dir_fd=parent)
        except FileNotFoundError:
            if trash is None:
                raise
        except OSError as error:
            if trash is None or error.errno not in (errno.ENOTDIR, errno.ELOOP):
                raise
            trash.take(name, parent)
        with contextlib.suppress(FileExistsError):
            os.mkdir(name, 0o755, dir_fd=parent)
            os.chmod(name, 0o755, dir_fd=parent)
    raise OSError(errno.EBUSY, "something else is put there again and again")


def write(root: str, trash: Trash, entry: dict[str, Any], source: int | None) -> None:
    """Write a file, a folder or a link.

    Args:
        root: Folder of the view.
        trash: Where what is there goes.
        entry: ``path``, ``kind`` (``"file"``, ``"folder"``, ``"fresh"`` for a folder that takes the place of one, or
            ``"link"``), ``mode``, and ``target`` of a link.
        source: File descriptor of a file's contents.

    Raises:
        OSError: It cannot be written.
    """
    *above, name = parts_of(entry["path"]) or [""]
    if not name:
        return
    parent = open_folder(root, above, trash)
    try:
        if entry["kind"] in ("folder", "fresh"):
            if entry["kind"] == "fresh":
                trash.take(name, parent)
            descriptor = _step(parent, name, trash)
            if entry["mode"] is not None:
                os.fchmod(descriptor, entry["mode"])
            os.close(descriptor)
            return
        trash.take(name, parent)
        if entry["kind"] == "link":
            os.symlink(entry["target"], name, dir_fd=parent)
        elif source is not None:
            copy_file(source, name, parent, entry["mode"])
    finally:
        os.close(parent)


def copy_file(source: int, name: str, parent: int, mode: int) -> None:
    """Copy an open file to a new one in an open folder."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    target = os.open(name, flags, 0o600, dir_fd=parent)
    try:
        offset = 0
        while data := os.pread(source, _PIECE, offset):
            offset += len(data)
            view = memoryview(data)
            while view:
                view = view[os.write(target, view) :]
        os.fchmod(target, mode)
    finally:
        os.close(target)


def remove(root: str, trash: Trash, path: str) -> None:
    """Remove a file or a folder."""
    parts = parts_of(path)
    if not parts:
        return
    try:
        parent = open_folder(root, parts[:-1], None)
    except OSError:
        return  # not there, or behind something that is no folder
    try:
        trash.take(parts[-1], parent)
    finally:
        os.close(parent)


def collect(root: str, path: str, most_bytes: int, into: int) -> list[tuple[str, int]]:
    """Append the regular files at a path to an open file.

    Returns:
        Their paths relative to ``path`` and their sizes, in the order in which they stand there.
    """
    parts = parts_of(path)
    index: list[tuple[str, int]] = []
    try:
        parent = open_folder(root, parts[:-1], None)
    except OSError:
        return index
    try:
        name = parts[-1] if parts else "."
        left = _collect(parent, name, "", most_bytes, into, index)
        if left is None:
            _walk(parent, name, "", [most_bytes, _MOST_LOOKED_AT], into, index, 0)
    finally:
        os.close(parent)
    return index


def _collect(parent: int, name: str, shown: str, left: int, into: int, index: list[tuple[str, int]]) -> int | None:
    """Append one file; return what is left of the bytes, None where it is no regular file."""
    try:
        if not stat.S_ISREG(os.lstat(name, dir_fd=parent).st_mode):
            return None
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        descriptor = os.open(name, flags, dir_fd=parent)
    except OSError:
        return None
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            return None
        if found.st_size > left:
            return left
        data = os.read(descriptor, found.st_size + 1) if found.st_size < _PIECE else _all(descriptor, found.st_size)
        data = data[:left]
    finally:
        os.close(descriptor)
    view = memoryview(data)
    while view:
        view = view[os.write(into, view) :]
    index.append((shown, len(data)))
    return left - len(data)


def _all(descriptor: int, size: int) -> bytes:
    pieces = []
    while size > 0 and (piece := os.read(descriptor, min(size, _PIECE))):
        pieces.append(piece)
        size -= len(piece)
    return b"".join(pieces)


def _walk(
    parent: int, name: str, shown: str, left: list[int], into: int, index: list[tuple[str, int]], depth: int
) -> None:
    if depth > _MOST_DEPTH:
        return
    try:
        folder = os.open(name, FOLDER_FLAGS, dir_fd=parent)
    except OSError:
        return
    try:
        for entry in sorted(os.listdir(folder))[:_MOST_FILES]:
            # The keeper does nothing else meanwhile, and folders without files have no end.
            left[1] -= 1
            if len(index) >= _MOST_FILES or left[1] < 0:
                return
            path = f"{shown}/{entry}" if shown else entry
            rest = _collect(folder, entry, path, left[0], into, index)
            if rest is None:
                _walk(folder, entry, path, left, into, index, depth + 1)
            else:
                left[0] = rest
    finally:
        os.close(folder)
