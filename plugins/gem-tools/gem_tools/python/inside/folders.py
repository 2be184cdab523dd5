"""Folders on disk for calls, where there are no namespaces: made, and removed whatever was left in them."""

from __future__ import annotations

import contextlib
import itertools
import os

_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


class Folders:
    """The private folders of one sandbox.

    Args:
        base: Folder that holds them; only its owner may list it.
    """

    def __init__(self, base: str) -> None:
        self.base = base
        self._numbers = itertools.count()
        os.chmod(base, 0o711)

    def make(self, uid: int | None) -> str:
        """Return a new folder of a user."""
        path = os.path.join(self.base, f"call-{next(self._numbers)}-{os.urandom(8).hex()}")
        os.mkdir(path, 0o700)
        if uid is not None:
            os.chown(path, uid, uid)
        return path

    def remove(self, path: str) -> None:
        """Remove a folder with all that is in it, however deep, whatever its permissions."""
        remove(path)

    def remove_all(self) -> None:
        """Remove every folder, and the base."""
        for name in _names(self.base):
            self.remove(os.path.join(self.base, name))
        with contextlib.suppress(OSError):
            os.rmdir(self.base)


def _names(folder: str) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


def remove(path: str) -> None:
    """Remove a file, or a folder with all that is in it."""
    parent, name = os.path.split(path)
    with contextlib.suppress(OSError):
        above = os.open(parent, _FOLDER)
        try:
            _remove(above, name)
            with contextlib.suppress(OSError):
                os.unlink(name, dir_fd=above)
        finally:
            os.close(above)


def _remove(above: int, name: str) -> None:
    """Remove a folder of an open one.

    One is open at a time, and none has a path here: neither the depth nor the length of names has a limit. No working
    folder changes, which the whole process would share.
    """
    levels: list[tuple[tuple[int, int], str, list[str]]] = []
    here = os.dup(above)
    try:
        entering: str | None = name
        while True:
            inner = None if entering is None else _entered(here, entering)
            if inner is not None and entering is not None:
                levels.append((_identity(here), entering, _folders_left(inner)))
                os.close(here)
                here = inner
            if not levels:
                return
            if levels[-1][2]:
                entering = levels[-1][2].pop()
                continue
            outside, own_name, _ = levels.pop()
            outer = os.open("..", _FOLDER, dir_fd=here)
            os.close(here)
            here = outer
            if _identity(here) != outside:
                return  # moved meanwhile: what is here now is none of ours
            with contextlib.suppress(OSError):
                os.rmdir(own_name, dir_fd=here)
            entering = None
    finally:
        os.close(here)


def _entered(folder: int, name: str) -> int | None:
    with contextlib.suppress(OSError):
        os.chmod(name, 0o700, dir_fd=folder)
    try:
        return os.open(name, _FOLDER, dir_fd=folder)
    except OSError:
        return None


def _folders_left(folder: int) -> list[str]:
    """Remove the files of a folder; return the names of the folders in it."""
    names = []
    with os.scandir(folder) as entries:
        found = [(entry.name, entry.is_dir(follow_symlinks=False)) for entry in entries]
    for name, is_folder in found:
        if is_folder:
            names.append(name)
        else:
            with contextlib.suppress(OSError):
                os.unlink(name, dir_fd=folder)
    return names


def _identity(folder: int) -> tuple[int, int]:
    found = os.fstat(folder)
    return found.st_dev, found.st_ino
