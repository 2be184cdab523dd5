"""Starting a machine: its volumes, its network, its services and its own container, in this order."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

from gem_terminal.backends.docker.containers import config, make_network, safe_name
from gem_terminal.backends.docker.running import Program, follow
from gem_terminal.backends.docker.sweeping import Thing, labels
from gem_terminal.errors import MachineLostError
from gem_terminal.kept_output import KeptOutput

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Client
    from gem_terminal.backends.interface import Limits, Resources
    from gem_terminal.tasks.task import Environment, Healthcheck, Network

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
            wait_until_healthy(client, full_name, what, container.healthcheck)


def wait_until_healthy(client: Client, name: str, what: str, check: Healthcheck) -> None:
    """Wait until a container is ready.

    Raises:
        MachineLostError: It ended, or is not ready after all tries.
    """
    began = time.monotonic()
    failures = 0
    words = " ".join(check.command)
    while True:
        output = KeptOutput(2000)
        with contextlib.closing(Program(client, name, check.command)) as program:
            code = follow(program, output, check.timeout_s)
        if code == 0:
            return
        state = client.inspect_container(name)["State"]
        if not state.get("Running"):
            ended = f"{what} ended with exit code {state.get('ExitCode')}"
            raise MachineLostError(f"a container ended before it was ready: {ended}", by_agent=False)
        if time.monotonic() - began > check.start_period_s:
            failures += 1
        if failures >= max(check.retries, 1):
            said = " ".join((bytes(output.head) + output.tail).decode("utf-8", "replace").split())[-300:]
            raise MachineLostError(
                f"a container was not ready after {failures} tries of {words!r}: "
                f"{'it took too long' if code is None else f'exit code {code}'} {said}",
                by_agent=False,
            )
        time.sleep(max(check.interval_s, 0.05))
