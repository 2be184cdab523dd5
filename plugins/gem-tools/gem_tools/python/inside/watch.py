"""What the processes of a call use, as the kernel tells it."""

from __future__ import annotations

import os

_TICKS = os.sysconf("SC_CLK_TCK")


def read(proc: int, path: str) -> bytes:
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


def has(proc: int, path: str) -> bool:
    """Whether a file of ``/proc`` is there."""
    return os.access(path, os.R_OK, dir_fd=proc)


def parents(proc: int) -> dict[int, int]:
    """Return the parent of every process that is alive; zombies are not."""
    found = {}
    for name in os.listdir(proc):
        if name.isdigit():
            # The name of the program stands in brackets and may hold anything.
            fields = read(proc, f"{name}/stat").rpartition(b") ")[2].split()
            if len(fields) > 1 and fields[0] not in (b"Z", b"X"):
                found[int(name)] = int(fields[1])
    return found


def children(proc: int, parent: int) -> list[int]:
    """Return the living children of a process, those that have lost their own parent to it included."""
    tasks = names(proc, f"{parent}/task")
    if not any(has(proc, f"{parent}/task/{task}/children") for task in tasks):
        # A kernel that was built without these lists.
        return [pid for pid, above in parents(proc).items() if above == parent]
    found = []
    for task in tasks:
        for pid in read(proc, f"{parent}/task/{task}/children").split():
            fields = read(proc, f"{int(pid)}/stat").rpartition(b") ")[2].split()
            if fields and fields[0] not in (b"Z", b"X"):
                found.append(int(pid))
    return found


def names(proc: int, path: str) -> list[str]:
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


def descendants(proc: int, root: int, without: frozenset[int] = frozenset()) -> list[int]:
    """Return the living processes below one, but for some with all that is below them."""
    children: dict[int, list[int]] = {}
    for pid, parent in parents(proc).items():
        children.setdefault(parent, []).append(pid)
    found: list[int] = []
    waiting = [root]
    while waiting:
        for pid in children.get(waiting.pop(), ()):
            if pid not in without:
                found.append(pid)
                waiting.append(pid)
    return found


def cpu_s(proc: int, pids: list[int]) -> float:
    """Add up the processor time of processes, and of those that they have waited for."""
    ticks = 0
    for pid in pids:
        fields = read(proc, f"{pid}/stat").rpartition(b") ")[2].split()
        if len(fields) > 14:
            ticks += sum(int(field) for field in fields[11:15])
    return ticks / _TICKS


def own_memory(pid: str = "self") -> tuple[int, int]:
    """Return the address space and the anonymous memory of a process, in bytes."""
    space = anonymous = 0
    with open(f"/proc/{pid}/status", "rb") as stream:
        for line in stream:
            if line.startswith(b"VmSize:"):
                space = int(line.split()[1]) * 1024
            elif line.startswith(b"RssAnon:"):
                anonymous = int(line.split()[1]) * 1024
    return space, anonymous
