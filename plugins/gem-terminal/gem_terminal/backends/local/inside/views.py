"""Views: the mount namespaces that programs run in, each with a root folder on disk of its own."""

from __future__ import annotations

import contextlib
import os
import signal
from typing import NamedTuple

from gem_terminal.backends.local.inside import kernel

SCRATCH = "/scratch"
"""Where the machine's folder is, for the keeper alone: ``root``, the agent's files, ``judges`` and ``trash``."""

_ASSEMBLY = "/view"


class View(NamedTuple):
    """A mount namespace.

    Args:
        folder: Its root folder, as the keeper sees it.
        descriptor: File descriptor of the namespace.
        identity: What ``/proc/PID/ns/mnt`` of its processes says.
        capabilities: What its processes may.
    """

    folder: str
    descriptor: int
    identity: str
    capabilities: tuple[int, ...]


def fence_kernel() -> None:
    """Forbid user namespaces in here, and writing to the kernel's settings.

    Raises:
        OSError: It cannot be forbidden.
    """
    with contextlib.suppress(OSError):
        kernel.unmount("/proc/sys")  # where bubblewrap has put a read-only one there
    with open("/proc/sys/user/max_user_namespaces", "w", encoding="ascii") as file:
        file.write("0")
    _read_only("/proc/sys")


def make(name: str, system: list[str], shm_mb: int, capabilities: tuple[int, ...]) -> View:
    """Return a view of a folder below ``SCRATCH``.

    Args:
        name: The folder.
        system: Paths that are shown in it as they are in here, read-only.
        shm_mb: Size of ``/dev/shm`` in megabytes.
        capabilities: What its processes may.

    Raises:
        OSError: It cannot be made.
    """
    folder = f"{SCRATCH}/{name}"
    told, tell = os.pipe()
    pid = os.fork()
    if pid == 0:
        words = b""
        try:
            _assemble(folder, system, shm_mb)
        except BaseException as error:  # noqa: BLE001 - a forked process must never return into the keeper's loop
            words = f"{type(error).__name__}: {error}".encode()[:500]
        os.write(tell, words or b"ready")
        while True:
            signal.pause()
    os.close(tell)
    try:
        answer = os.read(told, 1000)
        if answer != b"ready":
            raise OSError(f"no view of {folder}: {answer.decode('utf-8', 'replace') or 'it ended'}")
        descriptor = os.open(f"/proc/{pid}/ns/mnt", os.O_RDONLY | os.O_CLOEXEC)
        return View(folder, descriptor, os.readlink(f"/proc/{pid}/ns/mnt"), capabilities)
    finally:
        os.close(told)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def _assemble(folder: str, system: list[str], shm_mb: int) -> None:
    kernel.unshare(kernel.CLONE_NEWNS)
    kernel.mount("", "/", kernel.MS_REC | kernel.MS_PRIVATE)
    kernel.mount(folder, _ASSEMBLY, kernel.MS_BIND)
    for path in system:
        kernel.mount(path, f"{_ASSEMBLY}{path}", kernel.MS_BIND | kernel.MS_REC)
    # Only below /usr, which is read-only, can no one put something else in the way of a mount.
    kernel.mount(f"{folder}/usr/local", f"{_ASSEMBLY}/usr/local", kernel.MS_BIND)
    kernel.mount("/proc", f"{_ASSEMBLY}/proc", kernel.MS_BIND | kernel.MS_REC)
    kernel.mount("/dev", f"{_ASSEMBLY}/dev", kernel.MS_BIND | kernel.MS_REC)
    _read_only(f"{_ASSEMBLY}/dev", bind=False)
    options = f"mode=1777,size={shm_mb}m,nr_inodes=4096"
    kernel.mount("tmpfs", f"{_ASSEMBLY}/dev/shm", kernel.MS_NOSUID | kernel.MS_NODEV, "tmpfs", options)
    os.chdir(_ASSEMBLY)
    kernel.pivot_root()


def _read_only(path: str, *, bind: bool = True) -> None:
    """Make a mount read-only, or, with ``bind``, a folder; its flags that must stay do."""
    if bind:
        kernel.mount(path, path, kernel.MS_BIND | kernel.MS_REC)
    flags = os.statvfs(path).f_flag & (os.ST_NOSUID | os.ST_NODEV | os.ST_NOEXEC)
    # The three have the same value as a flag of a mounted file system and of mount(2).
    kernel.mount("", path, kernel.MS_BIND | kernel.MS_REMOUNT | kernel.MS_RDONLY | flags)
