"""How containers and their networks are made: what they may do and take, as the engine wants to be told."""

from __future__ import annotations

import random
import re
from typing import TYPE_CHECKING, Any

import docker.errors

from gem_terminal.backends.docker.sweeping import LIFE_S, labels
from gem_terminal.errors import TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Client
    from gem_terminal.backends.interface import Limits, Resources
    from gem_terminal.tasks.task import Container, Environment, Network, Task

POWERS = "AUDIT_WRITE CHOWN DAC_OVERRIDE FOWNER FSETID KILL NET_BIND_SERVICE SETFCAP SETGID SETPCAP SETUID SYS_CHROOT"
"""What root may do in a container: install packages, change owners, become others (sudo, su, sshd, cron).

These are Docker's own without MKNOD and NET_RAW.
"""

KEEPER = (
    "/bin/sh",
    "-c",
    f"IFS=. read -r now rest </proc/uptime; end=$((now + {LIFE_S})); "
    'while [ "$now" -lt "$end" ]; do sleep $((end - now)); IFS=. read -r now rest </proc/uptime; done',
)
"""First process of a container whose task names no command: it ends some day, and until then takes care of orphans.

It goes on though its ``sleep`` be killed, as by ``pkill sleep``. The engine's own first process, which takes care of
orphans too, would make the start of a container slower by a quarter (440 ms instead of 350).
"""

_MB = 2**20

_TRIES = 50
_OVERLAP = ("overlap", "already used", "already in use", "conflicts", "already allocated")
_draw = random.SystemRandom()


def config(container: Container, image: str, share: Resources, processes: int, *, is_service: bool) -> dict[str, Any]:
    """Return what is run in a container, and what it may do and take.

    ``no-new-privileges`` is not set: it would break ``sudo`` and ``su`` for an agent that is not root, and one that is
    has no more than ``POWERS`` in any case. The engine's filter of system calls stays on.

    Args:
        container: What the task asks for.
        image: Its image.
        share: What it gets.
        processes: Processes and threads at once.
        is_service: Whether it runs its image's command where the task names none.
    """
    memory, storage = int(share.memory_mb) * _MB, int(share.storage_mb) * _MB
    keeps = container.command is None and not is_service
    host: dict[str, Any] = {
        "Memory": memory,
        "MemorySwap": memory,
        "NanoCpus": int(share.cpus * 1e9),
        "PidsLimit": processes,
        "CapDrop": ["ALL"],
        "CapAdd": POWERS.split(),
        "NetworkMode": "none",
        "IpcMode": "private",
        "Init": not keeps,
        # What a container's first process writes would be kept on the engine's disk without end.
        "LogConfig": {"Type": "none"},
        "Ulimits": [
            {"Name": "core", "Soft": 0, "Hard": 0},
            {"Name": "fsize", "Soft": storage, "Hard": storage},
        ],
    }
    if container.shm_mb is not None:
        host["ShmSize"] = min(container.shm_mb * _MB, memory)
    said: dict[str, Any] = {
        "Image": image,
        "Labels": labels("service" if is_service else "machine"),
        "Env": [f"{name}={value}" for name, value in container.env.items()],
        "HostConfig": host,
        "Healthcheck": {"Test": ["NONE"]},  # ours ends once all is ready; the engine's would go on in between
        "StopTimeout": 1,
        "WorkingDir": container.workdir,
        "User": container.user,
        "Hostname": container.hostname,
    }
    command = KEEPER if keeps else container.command
    if command is not None:
        said["Cmd"] = list(command)
    if container.entrypoint is not None:
        said["Entrypoint"] = list(container.entrypoint) or [""]
    return said


def safe_name(name: str) -> str:
    """Return a name as the engine takes it for things."""
    return re.sub(r"[^a-zA-Z0-9_.-]+", "-", name).strip("-.") or "x"


def network_of(task: Task, environment: Environment, limits: Limits) -> Network:
    """Return what network a machine gets.

    Raises:
        TaskError: The task asks for one that no container engine has by itself.
    """
    asked = limits.network if limits.network != "task" else environment.network or "none"
    if asked == "allowlist":
        hosts = ", ".join(environment.allowed_hosts) or "none"
        raise TaskError(
            f"the task {task.name!r} asks for a network with the hosts {hosts} "
            "alone, which an engine does not have: choose network='none' or network='public'"
        )
    return "public" if asked == "public" else "none"


def make_network(client: Client, name: str, *, public: bool) -> None:
    """Make a network for one machine.

    Its 32 addresses are of those for measuring networks (198.18.0.0/15, RFC 2544), where nobody has machines: the
    engine's own choice of addresses ends at about thirty networks, and this has room for thousands.

    Args:
        client: The client.
        name: Its name.
        public: Whether it leads to the internet; the host has no address on one that does not.
    """
    said: dict[str, Any] = {
        "Name": name,
        "Internal": not public,
        "CheckDuplicate": True,
        "Options": {} if public else {"com.docker.network.bridge.inhibit_ipv4": "true"},
        "Labels": labels("network"),
    }
    for attempt in range(_TRIES):
        subnet = f"198.{_draw.randrange(18, 20)}.{_draw.randrange(256)}.{_draw.randrange(0, 256, 32)}/27"
        try:
            client.ask("POST", "/networks/create", json={**said, "IPAM": {"Config": [{"Subnet": subnet}]}})
            return
        except docker.errors.APIError as error:
            if attempt == _TRIES - 1 or not any(words in str(error).lower() for words in _OVERLAP):
                raise
