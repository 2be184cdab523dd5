"""What memory the processes of a call use: by the control group of the sandbox, or added up."""

from __future__ import annotations

import contextlib
import functools
import os
import stat

from gem_tools.python.inside import watch

_FIELDS = (b"rss", b"anon", b"shmem", b"swap", b"sock", b"kernel_stack", b"pagetables", b"slab_unreclaimable")
_V1, _V2 = "/sys/fs/cgroup/memory", "/sys/fs/cgroup"
_OWN_FILES = ("memory.stat", "memory.kmem.usage_in_bytes", "memory.kmem.tcp.usage_in_bytes", "memory.swap.current")
_SOCKET_BYTES = 4 * 212_992
"""What the buffers of a socket of a machine's own may hold (``net.core.wmem_max``, twice, in both directions)."""


class Group:
    """A control group that holds this sandbox and nothing else. It counts sockets, pipes and files in memory as well.

    Args:
        files: Those that count its memory, open.
    """

    def __init__(self, files: list[int]) -> None:
        self.files = files

    def counts(self) -> bool:
        """Whether this process is in it."""
        try:
            return self.memory() > 0
        except (OSError, ValueError, IndexError):
            return False

    def memory(self) -> int:
        """Return the bytes that its processes hold, without what the kernel has merely read for them."""
        total = 0
        for line in os.pread(self.files[0], 1 << 14, 0).splitlines():
            name, _, value = line.partition(b" ")
            if name in _FIELDS:
                total += int(value)
        return total + sum(int(os.pread(file, 64, 0)) for file in self.files[1:])


def group(files: list[int], *, own_machine: bool) -> Group | None:
    """Return the group that counts this sandbox; None where there is none."""
    if own_machine:
        for folder in _own_groups():
            with contextlib.suppress(OSError):
                files = [os.open(f"{folder}/{_OWN_FILES[0]}", os.O_RDONLY | os.O_CLOEXEC)]
                for name in _OWN_FILES[1:]:
                    if os.path.exists(f"{folder}/{name}"):
                        files.append(os.open(f"{folder}/{name}", os.O_RDONLY | os.O_CLOEXEC))
                break
    found = Group(files)
    return found if found.counts() else None


def _own_groups() -> list[str]:
    """Return where the group of a container may show: below the machine's, or in the place of it."""
    found = []
    with contextlib.suppress(OSError), open("/proc/self/cgroup", encoding="utf-8") as stream:
        for line in stream:
            number, controllers, path = line.rstrip("\n").split(":", 2)
            if number == "0":
                found.append(_V2 + path)
            elif "memory" in controllers.split(","):
                found += [_V1 + path, _V1]
    return found


def added_up(proc: int, pids: list[int], base_bytes: int) -> int:
    """Add up what processes hold, sockets included.

    Args:
        proc: File descriptor of ``/proc``.
        pids: The processes.
        base_bytes: Memory that each shares with the process that it was forked from.
    """
    pids = [watch.living_thread(proc, pid) for pid in pids]
    total = -base_bytes if len(pids) > 1 else 0
    for pid in pids:
        # What a single process has it shares with no other of its call; to look at each page takes time.
        part = _proportional(proc, pid) if len(pids) > 1 else None
        total += _resident(proc, pid, base_bytes) if part is None else part
    return max(0, total) + _open_bytes(proc, pids)


def _resident(proc: int, pid: int, base_bytes: int) -> int:
    """Return the bytes that a process uses, alone or with others."""
    found = -base_bytes
    for line in watch.read(proc, f"{pid}/status").splitlines():
        if line.startswith((b"RssAnon:", b"RssShmem:", b"VmSwap:")):
            found += int(line.split()[1]) * 1024
    return max(0, found)


def _proportional(proc: int, pid: int) -> int | None:
    """Return the bytes of a process, of those that it shares only its part; None where it cannot be looked into."""
    fields = [line.split() for line in watch.read(proc, f"{pid}/smaps_rollup").splitlines()]
    found = {words[0]: int(words[1]) * 1024 for words in fields if len(words) == 3}
    if b"Pss_Anon:" not in found:
        return None
    return sum(found.get(name, 0) for name in (b"Pss_Anon:", b"Pss_Shmem:", b"SwapPss:"))


def _open_bytes(proc: int, pids: list[int]) -> int:
    """Return what the open files of processes hold in memory, each once: sockets, and files that have no name left."""
    found = {}
    for pid in pids:
        for name in watch.names(proc, f"{pid}/fd"):
            with contextlib.suppress(OSError):
                entry = os.stat(f"{pid}/fd/{name}", dir_fd=proc)
                if stat.S_ISSOCK(entry.st_mode):
                    found[entry.st_dev, entry.st_ino] = _SOCKET_BYTES
                elif not entry.st_nlink and entry.st_dev in _in_memory():
                    found[entry.st_dev, entry.st_ino] = entry.st_blocks * 512
    return sum(found.values())


@functools.cache
def _in_memory() -> frozenset[int]:
    """Return the devices of the file systems that are in memory, and show here."""
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
        if os.stat(folder).st_dev not in _in_memory():
            return 0
        top = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:
        return 0
    found = {}
    # By open folders: a link that is put in the place of one leads nowhere else.
    for _, _, files, here in os.fwalk(dir_fd=top):
        for name in files:
            with contextlib.suppress(OSError):
                entry = os.stat(name, dir_fd=here, follow_symlinks=False)
                if uid in (None, entry.st_uid):
                    found[entry.st_ino] = entry.st_blocks * 512
    os.close(top)
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
