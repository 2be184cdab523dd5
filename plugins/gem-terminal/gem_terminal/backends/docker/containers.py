"""How containers are made: what they may do and take, as the engine wants to be told."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Limits
    from gem_terminal.tasks.task import Container

POWERS = (
    "AUDIT_WRITE",
    "CHOWN",
    "DAC_OVERRIDE",
    "FOWNER",
    "FSETID",
    "KILL",
    "NET_BIND_SERVICE",
    "SETFCAP",
    "SETGID",
    "SETPCAP",
    "SETUID",
    "SYS_CHROOT",
)
"""What root may do in a container: install packages, change owners, become others (sudo, su, sshd, cron).

These are Docker's own without MKNOD and NET_RAW. Processes with no more than these cannot look into processes that have
more, whoever they run as: what judges has one more, which is of no use in a container.
"""

JUDGES = (*POWERS, "MKNOD")
"""What the processes of a judge have."""

SLEEP = ("sleep", "infinity")
_MB = 2**20


def less(asked: float | None, limit: float) -> float:
    """Return what is given to a task that asks for something, under a limit."""
    return limit if asked is None else min(asked, limit)


def host_config(container: Container, limits: Limits, *, powers: Sequence[str] = POWERS) -> dict[str, Any]:
    """Return what a container may do and take.

    ``no-new-privileges`` is not set: it would break ``sudo`` and ``su`` for an agent that is not root, and one that is
    has no more than ``powers`` in any case. The engine's filter of system calls stays on.

    Args:
        container: What the task asks for.
        limits: What it may have at most.
        powers: Capabilities of its processes.
    """
    memory = int(less(container.memory_mb, limits.memory_mb)) * _MB
    storage = int(less(container.storage_mb, limits.storage_mb)) * _MB
    config: dict[str, Any] = {
        "Memory": memory,
        "MemorySwap": memory,
        "NanoCpus": int(less(container.cpus, limits.cpus) * 1e9),
        "PidsLimit": limits.processes,
        "CapDrop": ["ALL"],
        "CapAdd": list(powers),
        "Privileged": False,
        "NetworkMode": "none",
        "IpcMode": "private",
        # What a container's first process writes would be kept on the engine's disk without end.
        "LogConfig": {"Type": "none"},
        "RestartPolicy": {"Name": "no"},
        "Ulimits": [
            {"Name": "core", "Soft": 0, "Hard": 0},
            {"Name": "fsize", "Soft": storage, "Hard": storage},
        ],
    }
    if container.shm_mb is not None:
        config["ShmSize"] = min(container.shm_mb * _MB, memory)
    return config


def config(
    container: Container, image: str, labels: Mapping[str, str], host: Mapping[str, Any], *, sleeps: bool
) -> dict[str, Any]:
    """Return what is run in a container.

    Args:
        container: What the task asks for.
        image: Its image.
        labels: What marks it.
        host: As of :func:`host_config`.
        sleeps: Whether it sleeps for ever where the task names no command.
    """
    said: dict[str, Any] = {
        "Image": image,
        "Labels": dict(labels),
        "Env": [f"{name}={value}" for name, value in container.env.items()],
        "HostConfig": dict(host),
        "Healthcheck": {"Test": ["NONE"]},  # ours ends once all is ready; the engine's would go on in between
        "StopTimeout": 1,
        "AttachStdin": False,
        "AttachStdout": False,
        "AttachStderr": False,
    }
    command = container.command if container.command is not None or not sleeps else SLEEP
    if command is not None:
        said["Cmd"] = list(command)
    if container.entrypoint is not None:
        said["Entrypoint"] = list(container.entrypoint) or [""]
    if container.workdir:
        said["WorkingDir"] = container.workdir
    if container.user:
        said["User"] = container.user
    if container.hostname:
        said["Hostname"] = container.hostname
    return said


def judge_of(container: Container) -> Container:
    """Return the container of a judge: its image is what was committed, and nothing but sleep runs in it by itself."""
    return dataclasses.replace(container, entrypoint=(), command=SLEEP, healthcheck=None, hostname="", volumes={})


def safe_name(name: str) -> str:
    """Return a name as the engine takes it for things."""
    return re.sub(r"[^a-zA-Z0-9_.-]+", "-", name).strip("-.") or "x"
