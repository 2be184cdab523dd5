"""Folders on disk: one for each machine, locked while its process lives, and templates that machines start from."""

from __future__ import annotations

import fcntl
import os
import secrets
import stat
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from gem_terminal.backends.local import launch
from gem_terminal.errors import EngineError

_REMOVE_S = 300.0


@dataclass
class Place:
    """A machine's folder.

    Args:
        id: Its name.
        folder: Where it is.
        lock: File descriptor that holds its lock.
    """

    id: str
    folder: Path
    lock: int


class Scratch:
    """The folders of one user.

    Args:
        folder: Where they are; None for a folder of this user's in the system's folder for temporary files.
    """

    def __init__(self, folder: Path | str | None) -> None:
        self.folder = Path(folder or Path(tempfile.gettempdir(), f"gem-terminal-{os.getuid()}")).absolute()
        self.machines, self.templates = self.folder / "machines", self.folder / "templates"

    def open(self) -> None:
        """Make the folder where it is missing.

        Raises:
            EngineError: It cannot be made, or is another user's.
        """
        try:
            for folder in (self.folder, self.machines, self.templates):
                folder.mkdir(mode=0o711, parents=True, exist_ok=True)
            found = self.folder.lstat()
        except OSError as error:
            raise EngineError(f"no folder for machines: {error}; name another (TMPDIR, or 'folder')") from error
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
            raise EngineError(f"{self.folder} is not a folder that only this user writes to: name another (TMPDIR)")

    def take(self) -> Place:
        """Return a new machine's folder, with what a keeper expects in it but its root."""
        self.open()
        name = f"gem-terminal-{secrets.token_hex(6)}"
        with self.locked(self.folder / "lock"):
            lock = os.open(self.machines / f"{name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            fcntl.flock(lock, fcntl.LOCK_EX)
        folder = self.machines / name
        try:
            for path in (folder, folder / "trash", folder / "judges"):
                path.mkdir(mode=0o700)
                user = launch.uid()
                if user is not None:
                    os.chown(path, user, user)
        except BaseException:
            self.give_back(Place(name, folder, lock))
            raise
        return Place(name, folder, lock)

    def give_back(self, place: Place) -> None:
        """Remove a machine's folder; never raises."""
        remove(place.folder)
        with suppress(OSError):
            os.unlink(self.machines / f"{place.id}.lock")
        with suppress(OSError):
            os.close(place.lock)

    @contextmanager
    def locked(self, path: Path, *, shared: bool = False, wait: bool = True) -> Iterator[bool]:
        """Hold a lock file; False where another holds it and ``wait`` is not set."""
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            kind = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
            try:
                fcntl.flock(descriptor, kind)
            except BlockingIOError:
                yield False
            else:
                yield True
        finally:
            os.close(descriptor)

    def clean(self, *, images: bool) -> list[str]:
        """Remove folders of machines whose process is dead, and, with ``images``, templates nobody is using."""
        self.open()
        removed = []
        for lock in sorted(self.machines.glob("*.lock")):
            removed += self._clean_machine(lock)
        names = {path.name.split(".")[0] for path in self.templates.iterdir()}
        for name in sorted(names):
            removed += self._clean_template(name, images=images)
        return removed

    def _clean_machine(self, lock: Path) -> list[str]:
        folder = lock.with_suffix("")
        with ExitStack() as held:
            # Between its making and its locking, a lock file of a machine that is being made looks like a dead one's.
            # Nobody waits for what takes longer, the removal.
            with self.locked(self.folder / "lock"):
                if not lock.exists() or not held.enter_context(self.locked(lock, wait=False)):
                    return []
            remove(folder)
            with suppress(OSError):
                lock.unlink()
        return [f"machine {folder.name}"]

    def _clean_template(self, name: str, *, images: bool) -> list[str]:
        removed = []
        # The lock stays: without it, two processes could each hold one of the same name.
        with self.locked(self.templates / f"{name}.lock", wait=False) as free:
            found = [path for path in self.templates.glob(f"{name}*") if path.suffix != ".lock"] if free else []
            for path in found:
                if images or path.name != name:
                    remove(path)
                    removed.append(f"template {path.name}")
        return removed


def remove(folder: Path) -> None:
    """Remove a folder with all that is in it, whatever its depth and permissions; never raises."""
    for words in (["rm", "-rf", "--"], ["chmod", "-R", "u+rwX", "--"], ["rm", "-rf", "--"]):
        if not os.path.lexists(folder):
            return
        with suppress(OSError, subprocess.TimeoutExpired):
            subprocess.run(
                [*words, str(folder)],
                check=False,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=_REMOVE_S,
            )
