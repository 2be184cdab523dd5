"""The limit on what a machine writes, for engines that have none of their own.

Docker can limit a container's files only where they are on XFS with project quotas (or on btrfs, ZFS). Elsewhere what
each container has written is looked at again and again, and a machine that has written too much is ended. A single file
cannot grow past the limit in any case.
"""

from __future__ import annotations

import threading
import time
import weakref
from typing import TYPE_CHECKING

from gem_terminal.errors import MachineError, MachineLostError

if TYPE_CHECKING:
    from gem_terminal.backends.docker.machine import DockerMachine

_PAUSE_S = 2.0
_MOST_PAUSE_S = 15.0
_SHARE = 5.0


class DiskWatch:
    """Ends machines that write more than they may, in a thread of its own that lives as long as there are any."""

    def __init__(self) -> None:
        self._machines: weakref.WeakKeyDictionary[DockerMachine, float] = weakref.WeakKeyDictionary()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._wake = threading.Event()

    def add(self, machine: DockerMachine, limit_mb: float) -> None:
        """Watch a machine until it is removed."""
        with self._lock:
            self._machines[machine] = limit_mb
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._run, name="gem-terminal-disk", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """Stop watching."""
        with self._lock:
            self._machines.clear()
        self._wake.set()

    def _run(self) -> None:
        pause = _PAUSE_S
        while True:
            self._wake.wait(pause)
            self._wake.clear()
            started = time.monotonic()
            with self._lock:
                watched = list(self._machines.items())
                if not watched:
                    self._thread = None
                    return
            while watched:
                # Each is let go of before the next, so that watching keeps none of them from being removed.
                machine, limit_mb = watched.pop()
                if not look(machine, limit_mb):
                    with self._lock:
                        self._machines.pop(machine, None)
                del machine
            # Not for ever, however long looking takes: an agent can write a gigabyte in a few seconds.
            pause = min(max(_PAUSE_S, _SHARE * (time.monotonic() - started)), _MOST_PAUSE_S)


def look(machine: DockerMachine, limit_mb: float) -> bool:
    """End a machine that has written more than it may; False when there is nothing more to watch."""
    try:
        written_mb = machine.written_mb()
    except MachineLostError:
        return False
    except MachineError:
        return True
    if written_mb is not None and written_mb > limit_mb:
        machine.end(
            MachineLostError(f"the machine wrote {written_mb:.0f} MB, more than its {limit_mb:g}", by_agent=True)
        )
        return False
    return True
