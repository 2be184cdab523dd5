"""How the files of a view differ from the template that they came from, and putting them back."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator

from gem_terminal.backends.local.inside.files import FOLDER_FLAGS, Trash, copy_file, open_folder, parts_of, remove

TEMPLATE = "/template"
_MOST_PATHS = 300_000
_MOST_DEPTH = 200
_PIECE = 1 << 20
_MOUNTS = ("dev", "proc", "usr")  # of the last, only ``local`` is the view's own


class TooMuch(OSError):
    """There is more than can be compared."""


class Comparison:
    """Finds what differs.

    Args:
        since: Status change time, in nanoseconds, before which a file of the view is surely as it was copied.
    """

    def __init__(self, since: int) -> None:
        self._since = since
        self._seen = 0
        self.found: dict[str, str] = {}

    def run(self, root: str) -> dict[str, str]:
        """Compare a whole view.

        Raises:
            TooMuch: It has too many files.
            OSError: It cannot be read.
        """
        with _folder(TEMPLATE) as old, _folder(root) as new:
            self._walk(old, new, "", 0)
        return self.found

    def _walk(self, old: int | None, new: int, prefix: str, depth: int) -> None:
        if depth > _MOST_DEPTH:
            raise TooMuch(f"its folders lie in more than {_MOST_DEPTH} others")
        for name in sorted({*os.listdir(new), *(os.listdir(old) if old is not None else ())}):
            path = f"{prefix}/{name}"
            self._seen += 1
            if self._seen > _MOST_PATHS:
                raise TooMuch(f"it has more than {_MOST_PATHS} files")
            if not depth and name in _MOUNTS:
                if name == "usr":
                    self._entry(old, new, "usr/local", "/usr/local", depth)
            else:
                self._entry(old, new, name, path, depth)

    def _entry(self, old: int | None, new: int, name: str, path: str, depth: int) -> None:
        before, now = _look(name, old), _look(name, new)
        if now is None:
            if before is not None:
                self.found[path] = "removed"
            return
        if before is None:
            self.found[path] = "added"
        elif self._differs(name, old, new, before, now):
            self.found[path] = "changed"
        if stat.S_ISDIR(now.st_mode):
            with contextlib.suppress(FileNotFoundError, NotADirectoryError), _folder(name, new) as below:
                if before is not None and stat.S_ISDIR(before.st_mode):
                    with _folder(name, old) as above:
                        self._walk(above, below, path, depth + 1)
                else:
                    self._walk(None, below, path, depth + 1)

    def _differs(self, name: str, old: int | None, new: int, before: os.stat_result, now: os.stat_result) -> bool:
        if before.st_mode != now.st_mode or before.st_uid != now.st_uid or before.st_gid != now.st_gid:
            return True
        if stat.S_ISLNK(now.st_mode):
            return os.readlink(name, dir_fd=old) != os.readlink(name, dir_fd=new)
        if not stat.S_ISREG(now.st_mode):
            return before.st_rdev != now.st_rdev
        if before.st_size != now.st_size:
            return True
        # A program can set all times but this one.
        if before.st_mtime_ns == now.st_mtime_ns and now.st_ctime_ns < self._since:
            return False
        return not _same(name, old, new)


def put_back(root: str, trash: Trash, paths: list[str]) -> list[str]:
    """Make paths of a view what the template has there; return those that did differ.

    Raises:
        OSError: One cannot be written.
    """
    changed = []
    for path in paths:
        parts = parts_of(path)
        if parts and (parts[0] not in _MOUNTS or parts[:2] == ["usr", "local"]) and _put_back(root, trash, parts):
            changed.append(path)
    return changed


def _put_back(root: str, trash: Trash, parts: list[str]) -> bool:
    try:
        above = open_folder(TEMPLATE, parts[:-1], None)
    except OSError:
        above = None
    try:
        before = None if above is None else _look(parts[-1], above)
        if above is None or before is None:
            there = _there(root, parts)
            remove(root, trash, "/" + "/".join(parts))
            return there
        parent = open_folder(root, parts[:-1], trash)
        try:
            return _restore(above, parent, parts[-1], before, trash)
        finally:
            os.close(parent)
    finally:
        if above is not None:
            os.close(above)


def _restore(above: int, parent: int, name: str, before: os.stat_result, trash: Trash) -> bool:
    now = _look(name, parent)
    if now is not None:
        if stat.S_ISDIR(now.st_mode) and stat.S_ISDIR(before.st_mode):
            if now.st_mode == before.st_mode:
                return False
            with _folder(name, parent) as descriptor:
                os.fchmod(descriptor, stat.S_IMODE(before.st_mode))
            return True
        if not Comparison(0)._differs(name, above, parent, before, now):
            return False
        trash.take(name, parent)
    _copy(above, parent, name, before)
    return True


def _copy(above: int, parent: int, name: str, before: os.stat_result) -> None:
    mode = stat.S_IMODE(before.st_mode)
    if stat.S_ISLNK(before.st_mode):
        os.symlink(os.readlink(name, dir_fd=above), name, dir_fd=parent)
        return
    if stat.S_ISDIR(before.st_mode):
        os.mkdir(name, 0o700, dir_fd=parent)
        with _folder(name, above) as source, _folder(name, parent) as target:
            for inner in os.listdir(source):
                found = _look(inner, source)
                if found is not None:
                    _copy(source, target, inner, found)
            os.fchmod(target, mode)
    elif stat.S_ISREG(before.st_mode):
        source = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=above)
        try:
            copy_file(source, name, parent, mode)
        finally:
            os.close(source)
    else:
        os.mknod(name, before.st_mode, dir_fd=parent)
    os.utime(name, ns=(before.st_atime_ns, before.st_mtime_ns), dir_fd=parent, follow_symlinks=False)


def _there(root: str, parts: list[str]) -> bool:
    try:
        parent = open_folder(root, parts[:-1], None)
    except OSError:
        return False
    try:
        return _look(parts[-1], parent) is not None
    finally:
        os.close(parent)


def _look(name: str, folder: int | None) -> os.stat_result | None:
    if folder is None:
        return None
    try:
        return os.lstat(name, dir_fd=folder)
    except (FileNotFoundError, NotADirectoryError):
        return None


def _same(name: str, old: int | None, new: int) -> bool:
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    with contextlib.ExitStack() as stack:
        descriptors = []
        for folder in (old, new):
            try:
                descriptors.append(os.open(name, flags, dir_fd=folder))
            except OSError:
                return False  # it has just become something else
            stack.callback(os.close, descriptors[-1])
        while True:
            pieces = [os.read(descriptor, _PIECE) for descriptor in descriptors]
            if pieces[0] != pieces[1]:
                return False
            if not pieces[0]:
                return True


@contextlib.contextmanager
def _folder(name: str, parent: int | None = None) -> Iterator[int]:
    descriptor = os.open(name, FOLDER_FLAGS, dir_fd=parent)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
