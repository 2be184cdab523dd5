"""Folders on disk for calls, where there are no namespaces: made, and removed whatever was left in them."""

from __future__ import annotations

import contextlib
import itertools
import os
import stat


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
        with contextlib.suppress(OSError):
            os.chmod(path, 0o700)
        waiting = [path]
        while waiting:
            folder = waiting.pop()
            for name in _names(folder):
                entry = os.path.join(folder, name)
                if _is_folder(entry):
                    # Moved up before it is opened, so that no path grows longer than the system allows.
                    moved = os.path.join(self.base, f"gone-{next(self._numbers)}")
                    with contextlib.suppress(OSError):
                        os.chmod(entry, 0o700)
                        os.rename(entry, moved)
                        waiting.append(moved)
                else:
                    with contextlib.suppress(OSError):
                        os.unlink(entry)
            with contextlib.suppress(OSError):
                os.rmdir(folder)

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


def _is_folder(path: str) -> bool:
    try:
        return stat.S_ISDIR(os.lstat(path).st_mode)
    except OSError:
        return False
