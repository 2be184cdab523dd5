"""Control groups that count the memory of a sandbox, where the kernel lets this process make any."""

from __future__ import annotations

import contextlib
import functools
import os
import secrets
from collections.abc import Sequence
from pathlib import Path

_V1, _V2 = "/sys/fs/cgroup/memory", "/sys/fs/cgroup"
_COUNTED = ("memory.stat", "memory.kmem.usage_in_bytes", "memory.kmem.tcp.usage_in_bytes", "memory.swap.current")
_TCP_LIMIT = "memory.kmem.tcp.limit_in_bytes"
_JOIN = 'echo $$ >"$0/cgroup.procs"; exec "$@"'
_NAME = "gem-python-"


def new_path() -> str | None:
    """Return where a group can be made, below this process's own, whose limits hold for it; None where it cannot."""
    parent = _parent()
    return None if parent is None else os.path.join(parent, f"{_NAME}{os.getpid()}-{secrets.token_hex(8)}")


@functools.cache
def _parent() -> str | None:
    for parent in filter(os.path.isdir, _own()):
        _remove_left(parent)
        probe = os.path.join(parent, f"{_NAME}{os.getpid()}-{secrets.token_hex(8)}")
        try:
            os.mkdir(probe)
        except OSError:
            continue
        counts = os.path.exists(os.path.join(probe, _COUNTED[0]))
        remove(probe)
        if counts:
            return parent
    return None


def _own() -> list[str]:
    """Return the groups of this process that could have one below them, of either version."""
    found = []
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text("utf-8").splitlines():
            number, controllers, path = line.split(":", 2)
            if "memory" in controllers.split(","):
                found.append(_V1 + path)
            elif number == "0" and "memory" in Path(_V2 + path, "cgroup.subtree_control").read_text("ascii").split():
                found.append(_V2 + path)
    return found


def _remove_left(parent: str) -> None:
    """Remove what processes have left that were killed."""
    for path in Path(parent).glob(f"{_NAME}*"):
        if not os.path.exists(f"/proc/{path.name.split('-')[2]}"):
            remove(str(path))


def make(path: str) -> list[int]:
    """Make a group; return its files that count memory, open."""
    os.mkdir(path)
    with contextlib.suppress(OSError):
        # The first version counts the buffers of TCP where they have a limit, and nowhere else.
        Path(path, _TCP_LIMIT).write_text(str(1 << 40), "ascii")
    files = (os.path.join(path, name) for name in _COUNTED)
    return [os.open(file, os.O_RDONLY | os.O_CLOEXEC) for file in files if os.path.exists(file)]


def joining(path: str, command: Sequence[str]) -> list[str]:
    """Return a command that joins a group, then becomes another; if it may not, its keeper sees an empty group."""
    return ["/bin/sh", "-c", _JOIN, path, *command]


def remove(path: str) -> None:
    """Remove a group; one that is not empty yet is removed by a later process."""
    with contextlib.suppress(OSError):
        os.rmdir(path)
