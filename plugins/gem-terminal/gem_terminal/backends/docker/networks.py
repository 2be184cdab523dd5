"""The private network of a machine with services, and the way out of one that may have it."""

from __future__ import annotations

import ipaddress
import random
from typing import TYPE_CHECKING, Any

import docker.errors

from gem_terminal.backends.docker.labels import labels
from gem_terminal.errors import TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Client
    from gem_terminal.backends.interface import Limits
    from gem_terminal.tasks.task import Environment, Network, Task

# Meant for measuring networks (RFC 2544), so that nobody has machines there. The engine's own choice of addresses ends
# at about thirty networks; this has room for thousands.
_SPACE = ipaddress.IPv4Network("198.18.0.0/15")
_PREFIX = 27
_TRIES = 50
_OVERLAP = ("overlap", "already used", "already in use", "conflicts", "already allocated")
_draw = random.SystemRandom()


def network_of(task: Task, environment: Environment, limits: Limits) -> Network:
    """Return what network a machine gets.

    Raises:
        TaskError: The task asks for one that no container engine has by itself.
    """
    asked = limits.network if limits.network != "task" else environment.network or "none"
    if asked == "none":
        return "none"
    if asked == "public":
        return "public"
    if asked == "allowlist":
        hosts = ", ".join(environment.allowed_hosts) or "none"
        raise TaskError(
            f"the task {task.name!r} asks for a network with the hosts {hosts} "
            "alone, which an engine does not have: choose network='none' or network='public'"
        )
    raise TaskError(f"network {asked!r} is none of 'task', 'none', 'public'")


def make_network(client: Client, name: str, *, public: bool) -> None:
    """Make a network for one machine.

    Args:
        client: The client.
        name: Its name.
        public: Whether it leads to the internet; the host has no address on one that does not.
    """
    options = {} if public else {"com.docker.network.bridge.inhibit_ipv4": "true"}
    for attempt in range(_TRIES):
        subnets = 1 << (_PREFIX - _SPACE.prefixlen)
        start = int(_SPACE.network_address) + _draw.randrange(subnets) * (1 << (32 - _PREFIX))
        ipam = {"Driver": "default", "Config": [{"Subnet": f"{ipaddress.IPv4Address(start)}/{_PREFIX}"}]}
        said: dict[str, Any] = {
            "Name": name,
            "Driver": "bridge",
            "Internal": not public,
            "CheckDuplicate": True,
            "Options": options,
            "IPAM": ipam,
            "Labels": labels("network"),
        }
        try:
            client.ask("POST", "/networks/create", json=said)
            return
        except docker.errors.APIError as error:
            if attempt == _TRIES - 1 or not any(words in str(error).lower() for words in _OVERLAP):
                raise


def attached(host: dict[str, Any], network: str, aliases: list[str]) -> dict[str, Any]:
    """Return what joins a container to a network under some names, and note it in its host configuration."""
    host["NetworkMode"] = network
    return {"EndpointsConfig": {network: {"Aliases": aliases}}}
