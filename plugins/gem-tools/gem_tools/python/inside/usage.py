"""What the processes of a call use, as ``/proc`` tells it. The standard library has to do: images need no psutil."""

from __future__ import annotations

import contextlib
import functools
import os
import stat

_TICKS = os.sysconf("SC_CLK_TCK")
_STATE, _THREADS = 0, 17
_DEAD = (b"Z", b"X")
_SOCKET_BYTES = 4 * 212_992
"""What the buffers of a socket may hold (``net.core.wmem_max``, twice, in both directions)."""


def _read(proc: int, path: str) -> bytes:
    """Return a file of ``/proc``; nothing where the process is gone."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC, dir_fd=proc)
    except OSError:
        return b""
    try:
        return os.read(descriptor, 1 << 16)
    except OSError:
        return b""
    finally:
        os.close(descriptor)


def _names(proc: int, path: str) -> list[str]:
    """Return what is in a folder of ``/proc``; nothing where the process is gone."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=proc)
    except OSError:
        return []
    try:
        return os.listdir(descriptor)
    except OSError:
        return []
    finally:
        os.close(descriptor)


def _stat(proc: int, path: str) -> list[bytes]:
    """Return what ``stat`` tells of a process or thread, from its state on; nothing where it is gone."""
    # The name of the program stands in brackets and may hold anything.
    return _read(proc, f"{path}/stat").rpartition(b") ")[2].split()


def _lives(fields: list[bytes]) -> bool:
    """Whether any thread of a process is left: the first may end, as a zombie, while others go on."""
    return len(fields) > _THREADS and (fields[_STATE] not in _DEAD or int(fields[_THREADS]) > 1)


def children(proc: int, parent: int) -> list[int]:
    """Return the living children of a process, with those that came to it when their own parent ended."""
    found = []
    for task in _names(proc, f"{parent}/task"):
        pids = map(int, _read(proc, f"{parent}/task/{task}/children").split())
        found += [pid for pid in pids if _lives(_stat(proc, str(pid)))]
    return found


def tree(proc: int, roots: list[int]) -> list[int]:
    """Return some processes and all that are below them."""
    found, waiting = [], list(roots)
    while waiting:
        found.append(waiting.pop())
        waiting += children(proc, found[-1])
    return found


def cpu_s(proc: int, pids: list[int]) -> float:
    """Add up the processor time of processes, and of those that they have waited for."""
    fields = (_stat(proc, str(pid))[11:15] for pid in pids)
    return sum(int(ticks) for each in fields for ticks in each) / _TICKS


def own_memory() -> tuple[int, int]:
    """Return the address space and the anonymous memory of this process, in bytes."""
    with open("/proc/self/status", "rb") as stream:
        found = {line.split(b":")[0]: line.split() for line in stream}
    return int(found[b"VmSize"][1]) * 1024, int(found[b"RssAnon"][1]) * 1024


def memory(proc: int, pids: list[int], base_bytes: int) -> int:
    """Add up what processes hold in bytes, sockets and files without a name included.

    Args:
        proc: File descriptor of ``/proc``.
        pids: The processes.
        base_bytes: Memory that each shares with the process that it was forked from.
    """
    pids = [_living_thread(proc, pid) for pid in pids]
    total = -base_bytes if len(pids) > 1 else 0
    for pid in pids:
        # What a single process has it shares with no other of its call; to look at each page takes time.
        part = _proportional(proc, pid) if len(pids) > 1 else None
        total += _resident(proc, pid, base_bytes) if part is None else part
    return max(0, total) + _open_bytes(proc, pids)


def _living_thread(proc: int, pid: int) -> int:
    """Return a thread that shows the memory and the files of a process: the first, as long as that has not ended."""
    for task in [str(pid), *_names(proc, f"{pid}/task")]:
        fields = _stat(proc, f"{pid}/task/{task}")
        if fields and fields[_STATE] not in _DEAD:
            return int(task)
    return pid


def _resident(proc: int, pid: int, base_bytes: int) -> int:
    """Return the bytes that a process uses, alone or with others."""
    lines = [line.split() for line in _read(proc, f"{pid}/status").splitlines()]
    used = sum(int(words[1]) * 1024 for words in lines if words[0] in (b"RssAnon:", b"RssShmem:", b"VmSwap:"))
    return max(0, used - base_bytes)


def _proportional(proc: int, pid: int) -> int | None:
    """Return the bytes of a process, of those that it shares only its part; None where it cannot be looked into."""
    fields = [line.split() for line in _read(proc, f"{pid}/smaps_rollup").splitlines()]
    found = {words[0]: int(words[1]) * 1024 for words in fields if len(words) == 3}
    if b"Pss_Anon:" not in found:
        return None
    return sum(found.get(name, 0) for name in (b"Pss_Anon:", b"Pss_Shmem:", b"SwapPss:"))


def _open_bytes(proc: int, pids: list[int]) -> int:
    """Return what the open files of processes hold in memory, each once: sockets, and files that have no name left."""
    found = {}
    for pid in pids:
        for name in _names(proc, f"{pid}/fd"):
            with contextlib.suppress(OSError):
                entry = os.stat(f"{pid}/fd/{name}", dir_fd=proc)
                if stat.S_ISSOCK(entry.st_mode):
                    found[entry.st_dev, entry.st_ino] = _SOCKET_BYTES
                elif not entry.st_nlink and entry.st_dev in _devices_in_memory():
                    found[entry.st_dev, entry.st_ino] = entry.st_blocks * 512
    return sum(found.values())


@functools.cache
def _devices_in_memory() -> frozenset[int]:
    with open("/proc/self/mountinfo", "rb") as stream:
        lines = [line.split() for line in stream]
    numbers = [words[2].split(b":") for words in lines if words[words.index(b"-") + 1] == b"tmpfs"]
    return frozenset(os.makedev(int(major), int(minor)) for major, minor in numbers)


def tree_bytes(folder: str, uid: int | None = None) -> int:
    """Return what the files of a folder hold, where it is in memory and whatever is done to it meanwhile.

    Args:
        folder: Its path.
        uid: Whose files count; None for all.
    """
    try:
        if os.stat(folder).st_dev not in _devices_in_memory():
            return 0
        top = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:
        return 0
    found, waiting = {}, [top]
    # By open folders: a link that is put in the place of one leads nowhere else.
    while waiting:
        here = waiting.pop()
        for entry in os.scandir(here):
            with contextlib.suppress(OSError):
                if entry.is_dir(follow_symlinks=False):
                    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
                    waiting.append(os.open(entry.name, flags, dir_fd=here))
                else:
                    facts = entry.stat(follow_symlinks=False)
                    if uid in (None, facts.st_uid):
                        found[facts.st_ino] = facts.st_blocks * 512
        os.close(here)
    return sum(found.values())


def folder_bytes(proc: int, pid: int, folder: str) -> int:
    """Return what is in the folder of a process where that is a file system of its own, in memory."""
    try:
        descriptor = os.open(f"{pid}/root{folder}", os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=proc)
    except OSError:
        return 0
    try:
        system = os.fstatvfs(descriptor)
    finally:
        os.close(descriptor)
    return (system.f_blocks - system.f_bfree) * system.f_frsize
