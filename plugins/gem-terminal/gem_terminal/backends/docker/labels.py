"""What marks all that is made on an engine: labels that say what a thing is, and which process it belongs to."""

from __future__ import annotations

import os
from pathlib import Path

LABEL = "org.gem-llm.terminal"
"""Its value says what a thing is: ``machine``, ``service``, ``judge``, ``warden``, ``network``, ``image``."""

OWNER = "org.gem-llm.terminal.owner"
"""Its value names the process that a thing belongs to, as :func:`owner` does."""

RUN = "org.gem-llm.terminal.run"
"""Its value is ``GEM_TERMINAL_RUN`` of the process that made a thing, by which tests find their own; most have none."""


def labels(what: str) -> dict[str, str]:
    """Return the labels of something that this process makes now.

    Args:
        what: What it is, as ``machine``.
    """
    run = os.environ.get("GEM_TERMINAL_RUN", "")
    return {LABEL: what, OWNER: owner()} | ({RUN: run} if run else {})


def owner() -> str:
    """Return what names this process among all that were ever started on this machine; empty where that is unknown."""
    place = _place()
    started = _started(os.getpid())
    return f"{place}:{os.getpid()}:{started}" if place and started else ""


def is_dead(owned_by: str) -> bool:
    """Whether a process is surely dead; of those of other machines, or other containers, nothing is known.

    Args:
        owned_by: What :func:`owner` gave there.
    """
    place, _, rest = owned_by.partition(":")
    pid, _, started = rest.partition(":")
    return bool(place) and place == _place() and pid.isdecimal() and _started(int(pid)) != started


def _place() -> str:
    """Return what is the same for all processes that see one another: this start of the machine, and the namespace."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
        return f"{boot}/{os.stat('/proc/self/ns/pid').st_ino}"
    except OSError:
        return ""


def _started(pid: int) -> str:
    """Return when a process was started, in ticks of the kernel; empty where there is none, or one that has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if len(fields) < 20 or fields[0] in "ZX" else fields[19]
