"""Processes as ``/proc`` shows them: who is below whom, and how to end them all."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

_MOST_ROUNDS = 200


class Stat(NamedTuple):
    """A line of ``/proc``."""

    pid: int
    parent: int
    session: int
    started: int
    state: str
    ticks: int
    """Processor time that it, and those of its children that have been waited for, have taken."""


def read(pid: int) -> Stat | None:
    """Return what is known of a process; None when it has gone."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            data = file.read()
    except OSError:
        return None
    # Its name, in brackets, may hold anything.
    words = data[data.rindex(b")") + 2 :].split()
    ticks = sum(map(int, words[11:15]))
    return Stat(pid, int(words[1]), int(words[3]), int(words[19]), words[0].decode("ascii"), ticks)


def everyone() -> list[Stat]:
    """Return all processes that have not ended."""
    found = [read(int(name)) for name in os.listdir("/proc") if name.isdigit()]
    return [stat for stat in found if stat is not None and stat.state not in "ZX"]


def below(ancestor: int) -> list[Stat]:
    """Return all processes that have come from one, by their parents."""
    children: dict[int, list[Stat]] = {}
    for stat in everyone():
        children.setdefault(stat.parent, []).append(stat)
    found: list[Stat] = []
    waiting = [ancestor]
    while waiting:
        mine = children.pop(waiting.pop(), [])
        found += mine
        waiting += [stat.pid for stat in mine]
    return found


def in_view(identity: str) -> list[Stat]:
    """Return all processes of a mount namespace."""
    found = []
    for stat in everyone():
        with contextlib.suppress(OSError):
            if os.readlink(f"/proc/{stat.pid}/ns/mnt") == identity:
                found.append(stat)
    return found


def command_line(pid: int) -> str:
    """Return a process's words, cut to 200 characters, or its name in square brackets."""
    try:
        with open(f"/proc/{pid}/cmdline", "rb") as file:
            words = file.read(1000)
        if not words:
            with open(f"/proc/{pid}/comm", "rb") as file:
                words = b"[" + file.read(100).strip() + b"]"
    except OSError:
        return ""
    return words.rstrip(b"\0").replace(b"\0", b" ").decode("utf-8", "replace")[:200]


def kill(pid: int, started: int) -> None:
    """Kill a process, unless it has gone and its number is another's."""
    with contextlib.suppress(OSError):
        descriptor = os.pidfd_open(pid)
        try:
            stat = read(pid)
            if stat is not None and stat.started == started:
                signal.pidfd_send_signal(descriptor, signal.SIGKILL)
        finally:
            os.close(descriptor)


def stop(pid: int) -> None:
    """Stop a process, and wait until it has: until then it may still fork."""
    with contextlib.suppress(OSError):
        os.kill(pid, signal.SIGSTOP)
    for _ in range(_MOST_ROUNDS):
        stat = read(pid)
        if stat is None or stat.state in "TtZX":
            return
        time.sleep(0.001)


def kill_all(find: Callable[[], Iterable[Stat]]) -> None:
    """Kill all processes that a search finds, and those that they start meanwhile."""
    for _ in range(_MOST_ROUNDS):
        found = list(find())
        if not found:
            return
        # Stopped first: what forks faster than it is killed would never end.
        for number in (signal.SIGSTOP, signal.SIGKILL):
            for stat in found:
                with contextlib.suppress(OSError):
                    os.kill(stat.pid, number)
