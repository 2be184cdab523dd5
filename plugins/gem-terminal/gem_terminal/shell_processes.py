"""Which processes a command has started, wherever they have gone since."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Process

_TICKS = 100
"""Clock ticks of a second in ``/proc``, on every architecture of today."""


@dataclass(frozen=True)
class Beginning:
    """When a command began.

    Args:
        uptime_s: Seconds since the start of the machine, as its shell read them.
        background: Number of the last process that was put in the background before; 0 for none.
    """

    uptime_s: float
    background: int = 0


def started_by_command(
    processes: Sequence[Process], beginning: Beginning, *, shell: int, leader: int, opened_s: float | None
) -> list[Process]:
    """Return the processes that a command has started, also those in sessions of their own.

    Those are the ones that are younger than the command, unless they come from a process that is older, the shell
    apart: an earlier background job may start what it likes. A process whose parent has ended belongs to the first one,
    and is the command's when it is younger.

    Args:
        processes: All there are.
        beginning: When the command began.
        shell: Number of the shell.
        leader: Number of the process that started the shell.
        opened_s: What the uptime was when the leader began; corrects one that counts from elsewhere than the processes'
            times, as in containers that are shown an uptime of their own.
    """
    by_number = {process.pid: process for process in processes}
    since = round(beginning.uptime_s * _TICKS) + _correction(by_number.get(leader), opened_s)
    ours = {shell, leader}

    def is_young(process: Process) -> bool:
        return process.started >= since and process.pid not in ours and process.pid != beginning.background

    def is_started(process: Process) -> bool:
        seen: set[int] = set()
        while is_young(process) and process.pid not in seen:
            seen.add(process.pid)
            if process.parent == 0:
                return False  # put there from outside, as a verifier is
            parent = by_number.get(process.parent)
            if parent is None or parent.pid in (1, *ours):
                return True
            process = parent
        return False

    return [process for process in processes if is_started(process)]


def _correction(leader: Process | None, opened_s: float | None) -> int:
    if leader is None or opened_s is None:
        return 0
    behind = round(opened_s * _TICKS) - leader.started
    return 0 if 0 <= behind <= 60 * _TICKS else -behind
