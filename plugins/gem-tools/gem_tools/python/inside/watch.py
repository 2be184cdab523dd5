"""What the processes of a call use, as the kernel tells it."""

from __future__ import annotations

import os

_TICKS = os.sysconf("SC_CLK_TCK")
_STATE, _PARENT, _THREADS = 0, 1, 17
_DEAD = (b"Z", b"X")


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
            fields = _facts(proc, name)
            if _lives(fields):
                found[int(name)] = int(fields[_PARENT])
    return found


def _facts(proc: int, path: str) -> list[bytes]:
    """Return what ``stat`` tells of a process or thread, from its state on; nothing where it is gone."""
    # The name of the program stands in brackets and may hold anything.
    return read(proc, f"{path}/stat").rpartition(b") ")[2].split()


def _lives(fields: list[bytes]) -> bool:
    """Whether any thread of a process is left: the first may end, as a zombie, while others go on."""
    return len(fields) > _THREADS and (fields[_STATE] not in _DEAD or int(fields[_THREADS]) > 1)


def living_thread(proc: int, pid: int) -> int:
    """Return a thread that shows the memory and the files of a process: the first, as long as that has not ended."""
    fields = _facts(proc, str(pid))
    if fields and fields[_STATE] in _DEAD:
        for task in names(proc, f"{pid}/task"):
            fields = _facts(proc, f"{pid}/task/{task}")
            if fields and fields[_STATE] not in _DEAD:
                return int(task)
    return pid


def children(proc: int, parent: int) -> list[int]:
    """Return the living children of a process, those that have lost their own parent to it included."""
    tasks = names(proc, f"{parent}/task")
    if not any(has(proc, f"{parent}/task/{task}/children") for task in tasks):
        # A kernel that was built without these lists.
        return [pid for pid, above in parents(proc).items() if above == parent]
    found = []
    for task in tasks:
        pids = map(int, read(proc, f"{parent}/task/{task}/children").split())
        found += [pid for pid in pids if _lives(_facts(proc, str(pid)))]
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
        fields = _facts(proc, str(pid))
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
