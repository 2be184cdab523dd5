"""How a process that was just forked is cut off from all the others, before it sees any code."""

from __future__ import annotations

import contextlib
import fcntl
import glob
import os
import resource
import signal
import socket
import struct
from typing import Any

from gem_tools.python.inside import kernel

FOLDER = "/tmp"
SHARED = "/dev/shm"
"""The machine's shared memory, by name."""
INSIDE_ID = 1000
_MB = 1 << 20
_SET_INTERFACE_FLAGS, _UP = 0x8914, 1


def hide(folder: str, shown: list[str]) -> None:
    """Put an empty folder in the place of one that only root may enter, with what code needs of it shown again.

    Args:
        folder: As in ``/root``.
        shown: Folders in it, as those of the interpreter.

    Raises:
        OSError: This process may not mount anything.
    """
    kernel.unshare(kernel.NEWNS)
    kernel.mount("none", "/", "none", kernel.MS_REC | kernel.MS_PRIVATE)
    kept = [os.open(path, os.O_PATH | os.O_DIRECTORY) for path in shown]
    kernel.mount("tmpfs", folder, "tmpfs", kernel.MS_NOSUID | kernel.MS_NODEV, "mode=0755,size=1m")
    for path, descriptor in zip(shown, kept, strict=True):
        os.makedirs(path, mode=0o755, exist_ok=True)
        kernel.mount(f"/proc/self/fd/{descriptor}", path, "none", kernel.MS_BIND | kernel.MS_REC)
        os.close(descriptor)


def leave_network() -> None:
    """Leave the network and shared memory behind, where this process may; the filter of system calls does so too."""
    with contextlib.suppress(OSError):
        kernel.unshare(kernel.NEWNET | kernel.NEWIPC)


def enter(settings: dict[str, Any], proc: int, uid: int | None, kind: dict[str, Any]) -> None:
    """Take this process out of reach of the others.

    Args:
        settings: Those of the level.
        proc: File descriptor of ``/proc``, which may not be in the tree.
        uid: The user to become; None to stay.
        kind: Size and number of files of its folder, and whether it is for a session.
    """
    os.setsid()
    if uid is not None:
        os.setgroups([])
        os.setresgid(uid, uid, uid)
        os.setresuid(uid, uid, uid)
    if not settings["namespaces"]:
        # Gone with the process that forked it.
        kernel.prctl(kernel.PR_SET_PDEATHSIG, 9)
        return
    # Without this its own files in /proc belong to root, and the maps below could not be written.
    kernel.prctl(kernel.PR_SET_DUMPABLE, 1)
    user, group = os.getuid(), os.getgid()
    # A user namespace for each call: its processes are counted by themselves, its capabilities reach nothing, and its
    # folder ends with it. A session has a network too: other calls run between its own. Shared memory and queues are
    # kept away by the filter of system calls, if there is one.
    kernel.unshare(
        kernel.NEWUSER
        | kernel.NEWNS
        | (kernel.NEWNET if kind["session"] else 0)
        | (0 if settings["filtered"] else kernel.NEWIPC)
    )
    _write(proc, "self/setgroups", "deny")
    _write(proc, "self/uid_map", f"{INSIDE_ID} {user} 1")
    _write(proc, "self/gid_map", f"{INSIDE_ID} {group} 1")
    mount_folder(kind)
    if kind["session"]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
            fcntl.ioctl(any_socket, _SET_INTERFACE_FLAGS, struct.pack("16sh14x", b"lo", _UP))


def mount_folder(kind: dict[str, Any]) -> None:
    """Mount an empty folder of limited size in memory."""
    options = f"size={kind['folder_mb'] * _MB},nr_inodes={kind['folder_files']},mode=0700"
    kernel.mount("tmpfs", FOLDER, "tmpfs", kernel.MS_NOSUID | kernel.MS_NODEV, options)


def make_folder(base: str, uid: int | None) -> str:
    """Return a new folder of a user on disk, in the one that holds all of a sandbox."""
    path = os.path.join(base, f"call-{os.urandom(12).hex()}")
    os.mkdir(path, 0o700)
    if uid is not None:
        os.chown(path, uid, uid)
    return path


def remove_folder(path: str) -> None:
    """Remove a folder with all that is in it, however deep, whatever its permissions, or a file.

    Most calls leave an empty folder. ``shutil.rmtree`` fails at folders within folders by the thousand.
    """
    with contextlib.suppress(OSError):
        try:
            os.rmdir(path)
        except NotADirectoryError:
            os.unlink(path)
        except OSError:
            for command in (["chmod", "-R", "u+rwX", path], ["rm", "-rf", path]):
                quiet = [(os.POSIX_SPAWN_OPEN, 2, os.devnull, os.O_WRONLY, 0)]
                os.waitpid(os.posix_spawnp(command[0], command, os.environ, file_actions=quiet), 0)


def clear_shared(uid: int) -> None:
    """Remove what a call has left in the machine's shared memory; each has a user id of its own."""
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(SHARED)):
            with contextlib.suppress(OSError):
                if entry.stat(follow_symlinks=False).st_uid == uid:
                    remove_folder(entry.path)


def limit(limits: dict[str, Any], others: int, base_bytes: int) -> None:
    """Set every limit that the kernel keeps for one process, hard ones.

    Args:
        limits: Those of a call.
        others: Threads of this user that are not the call's, where the kernel counts them together.
        base_bytes: Address space that the interpreter has before it runs any code.
    """
    wanted = [
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_AS, base_bytes + limits["memory_mb"] * _MB),
        (resource.RLIMIT_FSIZE, limits["file_mb"] * _MB),
        (resource.RLIMIT_NOFILE, limits["open_files"]),
        (resource.RLIMIT_MEMLOCK, 0),
        (resource.RLIMIT_MSGQUEUE, 0),
        (resource.RLIMIT_SIGPENDING, 1024),
        (resource.RLIMIT_NPROC, others + limits["processes"]),
    ]
    if not limits["session"]:
        wanted.append((resource.RLIMIT_CPU, int(limits["cpu_s"]) + 1))
    for kind, most in wanted:
        _, hard = resource.getrlimit(kind)
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (least, least))


def open_many() -> None:
    """Let this process open as many files as it may: each session takes some."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def kill_user(uid: int, nobody: int) -> None:
    """Kill all processes of a user, in one step of the kernel: while it looks, none of them can fork.

    Args:
        uid: The user.
        nobody: A user without any process. This process takes its id, so that those of ``uid`` cannot signal it.
    """
    os.setresuid(nobody, uid, 0)
    try:
        os.kill(-1, signal.SIGKILL)
    finally:
        os.setresuid(0, 0, 0)


def own_tasks() -> int:
    """Count the threads of this process's user, which the kernel's limit counts together."""
    count = 0
    for path in glob.glob("/proc/[0-9]*/status"):
        with contextlib.suppress(OSError), open(path, "rb") as stream:
            fields = dict(line.split(b":", 1) for line in stream)
            if int(fields[b"Uid"].split()[0]) == os.getuid():
                count += int(fields[b"Threads"])
    return max(count - 1, 0)


def _write(proc: int, path: str, text: str) -> None:
    descriptor = os.open(path, os.O_WRONLY, dir_fd=proc)
    try:
        os.write(descriptor, text.encode())
    finally:
        os.close(descriptor)


def raise_oom_score() -> None:
    """Ask the kernel to kill this process and its children first if memory runs out."""
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as stream:
        stream.write("1000")
