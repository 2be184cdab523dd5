"""Starting a machine: its volumes, its network, its services and its own container, as the engine wants to be told."""

from __future__ import annotations

import contextlib
import random
import re
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import docker.errors

from gem_terminal.backends.docker.running import ContainerProgram, follow
from gem_terminal.backends.docker.sweeping import LIFE_S, Thing, labels
from gem_terminal.backends.interface import Completed
from gem_terminal.errors import MachineLostError, TaskError
from gem_terminal.kept_output import KeptOutput
from gem_terminal.tasks.staging import wait_until_healthy

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Client
    from gem_terminal.backends.interface import Limits, Resources
    from gem_terminal.tasks.task import Container, Environment, Healthcheck, Network, Task

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
_MAIN_NAMES = ("main", "client")


def start(
    client: Client,
    name: str,
    things: list[Thing],
    environment: Environment,
    images: Mapping[str, str],
    network: Network,
    limits: Limits,
    there: Resources,
) -> None:
    """Start all that a machine is made of, and wait until it is ready.

    What each container may take is in ``limits``, what the computer has in ``there``, and ``images`` has those of the
    services by their names, and that of the main container under ``""``. Each thing is noted in ``things`` before it is
    made, so that it is removed whatever happens: before those that are in it.

    Raises:
        MachineLostError: A container ended, or is not ready after all tries.
        docker.errors.APIError: The engine refused.
    """
    everyone = {**environment.services, "": environment.main}
    volumes = {volume: f"{name}-{safe_name(volume)}" for one in everyone.values() for volume in one.volumes}
    for volume in volumes.values():
        things.insert(0, ("volume", volume))
        client.create_volume(volume, labels=labels("volume"))
    joined = f"{name}-net" if environment.services or network == "public" else ""
    if joined:
        things.insert(0, ("network", joined))
        make_network(client, joined, public=network == "public")
    for service, container in everyone.items():
        said = config(
            container,
            images[service],
            limits.share(container, there),
            limits.processes,
            is_service=bool(service),
        )
        said["HostConfig"]["Mounts"] = [
            {"Type": "volume", "Source": volumes[volume], "Target": path} for volume, path in container.volumes.items()
        ]
        if joined:
            aliases = [service] if service else [*_MAIN_NAMES]
            aliases += [container.hostname] if container.hostname else []
            said["HostConfig"]["NetworkMode"] = joined
            said["NetworkingConfig"] = {"EndpointsConfig": {joined: {"Aliases": aliases}}}
        full_name = f"{name}-{safe_name(service)}" if service else name
        things.insert(0, ("container", full_name))
        client.ask("POST", "/containers/create", params={"name": full_name}, json=said)
        client.start(full_name)
        if container.healthcheck is not None:
            what = f"the service {service!r}" if service else "the container"
            attempt = partial(_tried, client, full_name, what, container.healthcheck)
            wait_until_healthy(container.healthcheck, attempt, "a container", by_agent=False)


def _tried(client: Client, name: str, what: str, check: Healthcheck) -> Completed:
    """Run a healthcheck once in a container that has to run for it."""
    output = KeptOutput(2000)
    with contextlib.closing(ContainerProgram(client, name, check.command)) as program:
        code = follow(program, output, check.timeout_s)
    state = {"Running": True} if code == 0 else client.inspect_container(name)["State"]
    if not state.get("Running"):
        ended = f"{what} ended with exit code {state.get('ExitCode')}"
        raise MachineLostError(f"a container ended before it was ready: {ended}", by_agent=False)
    return Completed(code, bytes(output.head) + output.tail)


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
