"""Labels on all that is made on an engine, and the removal of what dead processes have left there."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import docker.errors

from gem_core.errors import GemError
from gem_terminal.backends.docker.engine import FAILURES

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Engine

LABEL = "gem-terminal"
"""Its value says what a thing is: ``machine``, ``service``, ``network``, ``volume``, ``image``."""

OWNER = "gem-terminal.owner"
"""Its value names the process that a thing belongs to, as :func:`owner` does."""

EXPIRES = "gem-terminal.expires"
"""Its value is the Unix time after which a thing is of no use to anybody, also where its owner cannot be looked for."""

RUN = "gem-terminal.run"
"""Its value is ``GEM_TERMINAL_RUN`` of the process that made a thing, by which tests find their own; most have none."""

REPOSITORY = "gem-terminal"
"""Images are ``gem-terminal:DIGEST``."""

LIFE_S = 48 * 3600
"""Seconds after which the agent's container ends by itself."""

Thing = tuple[Literal["container", "volume", "network"], str]
"""A kind of thing on an engine, and its name or identifier."""


def labels(what: str) -> dict[str, str]:
    """Return the labels of something that this process makes now.

    Args:
        what: What it is, as ``machine``.
    """
    marks = {LABEL: what, OWNER: owner(), EXPIRES: str(int(time.time()) + LIFE_S)}
    run = os.environ.get("GEM_TERMINAL_RUN")
    return marks | ({RUN: run} if run else {})


def owner() -> str:
    """Return what names this process among all that were ever started; empty where the system does not tell (macOS)."""
    place, started = _place(), _started(os.getpid())
    return f"{place}:{os.getpid()}:{started}" if place and started else ""


def is_dead(owned_by: str) -> bool:
    """Whether a process is surely dead; of other users' and other machines' processes nothing is known.

    Args:
        owned_by: What :func:`owner` gave there.
    """
    place, _, rest = owned_by.partition(":")
    pid, _, started = rest.partition(":")
    return bool(place) and place == _place() and pid.isdecimal() and _started(int(pid)) != started


def _place() -> str:
    """Return what a user's processes that see one another share: start of the machine, namespace, and user."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
        return f"{boot}/{os.stat('/proc/self/ns/pid').st_ino}/{os.getuid()}"
    except OSError:
        return ""


def _started(pid: int) -> str:
    """Return when a process was started, in ticks of the kernel; empty where there is none, or one that has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if len(fields) < 20 or fields[0] in "ZX" else fields[19]


def sweep(engine: Engine, *, owned_by: str = "") -> list[str]:
    """Remove containers, volumes and networks whose owner is dead, or whose time is over.

    Args:
        engine: The engine.
        owned_by: Also all that this one owns, which lives.

    Returns:
        What was removed, a line each.

    Raises:
        EngineError: The engine does not answer.
    """
    wanted = {"label": [OWNER]}
    with engine.asking("look for what was left behind") as client:
        containers = client.containers(all=True, filters=wanted)
        volumes = client.volumes(filters=wanted).get("Volumes") or []
        networks = client.networks(filters=wanted)
    names = [(row.get("Names") or [row["Id"]])[0].lstrip("/") for row in containers]
    found: list[tuple[Thing, Any]] = [(("container", name), row) for name, row in zip(names, containers, strict=True)]
    found += [(("volume", row["Name"]), row) for row in volumes]
    found += [(("network", row["Name"]), row) for row in networks]
    removed = []
    for thing, row in found:
        marks = row["Labels"]
        expires = marks.get(EXPIRES, "")
        is_over = expires.isdecimal() and int(expires) < time.time()
        is_left = is_over or is_dead(marks[OWNER]) or (owned_by and marks[OWNER] == owned_by)
        if is_left and not remove(engine, [thing]):
            removed.append(f"{thing[0]} {marks.get(LABEL, '')} {thing[1]}")
    return removed


def remove(engine: Engine, things: Iterable[Thing]) -> list[Thing]:
    """Remove things in their order; never raises, and returns those that are still there, as far as is known."""
    left = []
    for kind, name in things:
        try:
            if kind == "container":
                engine.client.remove_container(name, v=True, force=True)
            elif kind == "volume":
                engine.client.remove_volume(name, force=True)
            else:
                engine.client.remove_network(name)
        except (GemError, *FAILURES) as error:
            if not isinstance(error, docker.errors.NotFound) and "is already in progress" not in str(error):
                left.append((kind, name))
    return left
