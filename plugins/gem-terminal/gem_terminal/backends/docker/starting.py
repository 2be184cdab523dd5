"""Starting a machine: its volumes, its network, its services and its own container, in this order."""

from __future__ import annotations

import random
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import docker.errors

from gem_terminal.backends.docker.containers import JUDGES, config, host_config, judge_of, less, safe_name
from gem_terminal.backends.docker.labels import labels
from gem_terminal.backends.docker.machine import DockerMachine, Parts, Prepare
from gem_terminal.backends.docker.networks import attached, make_network
from gem_terminal.backends.docker.putting_back import changes, program
from gem_terminal.backends.docker.terminal import Running, StuckError, Wish, begin, execute
from gem_terminal.backends.docker.things import Things
from gem_terminal.backends.docker.warden import Warden, frozen
from gem_terminal.errors import EngineError, MachineLostError

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Client, Engine
    from gem_terminal.backends.docker.files import Links
    from gem_terminal.backends.interface import Limits
    from gem_terminal.tasks.task import Container, Environment, Healthcheck, Network

_draw = random.SystemRandom()
_MAIN_NAMES = ["main", "client"]
_FIRST_S = 60.0
_COMMIT_S = 600.0
"""Seconds for a copy of all that an agent wrote, which may be gigabytes."""


@dataclass(frozen=True)
class Plan:
    """What is started for a machine.

    Args:
        environment: What the task asks for.
        images: Of the services by their names, and of the main container under ``""``.
        base: What names the main container's for good.
        limits: What each container may take.
        network: The network it gets.
        has_quota: Whether the engine can limit what a container writes.
        has_init: Whether the engine has a first process that takes care of orphans.
    """

    environment: Environment
    images: Mapping[str, str]
    base: str
    limits: Limits
    network: Network
    has_quota: bool
    has_init: bool


class Starter:
    """Starts one machine.

    Args:
        engine: The engine.
        plan: What is started.
        links: The links that are its image's own.
    """

    def __init__(self, engine: Engine, plan: Plan, links: Links) -> None:
        self._engine = engine
        self._plan = plan
        self._links = links
        self._things = Things(engine)
        self._name = f"gem-terminal-{secrets.token_hex(8)}"
        self._volumes: dict[str, str] = {}
        self._network = ""

    def start(self) -> DockerMachine:
        """Start all of it, and wait until it is ready; what was started is removed again when that fails."""
        try:
            with self._engine.asking("start a machine") as client:
                return self._start(client)
        except docker.errors.NotFound as error:
            self._things.remove()
            raise EngineError(f"could not start a machine: {error.explanation or error}") from error
        except BaseException:
            self._things.remove()
            raise

    def _start(self, client: Client) -> DockerMachine:
        environment, plan = self._plan.environment, self._plan
        everyone = {**environment.services, "": environment.main}
        for volume in sorted({name for container in everyone.values() for name in container.volumes}):
            self._volumes[volume] = f"{self._name}-{safe_name(volume)}"
            self._things.volumes.append(self._volumes[volume])
            client.create_volume(self._volumes[volume], labels=labels("volume"))
        if environment.services or plan.network == "public":
            self._network = f"{self._name}-net"
            self._things.networks.append(self._network)
            make_network(client, self._network, public=plan.network == "public")
        for name, container in environment.services.items():
            self._run(client, f"{self._name}-{safe_name(name)}", container, name)
        self._run(client, self._name, environment.main, "")
        if plan.has_init and not self._engine.is_podman:
            _wait_for_first(client, self._name)
        warden = Warden(self._engine, self._things, plan.base, self._name)
        parts = Parts(
            self._engine, self._name, self._things, warden, self._links, plan.base, plan.limits, has_init=plan.has_init
        )
        parts.judge = self._judge
        machine = DockerMachine(parts)
        if environment.main.healthcheck is not None:
            wait_healthy(client, self._name, environment.main.healthcheck, machine.why_lost)
        return machine

    def _run(self, client: Client, name: str, container: Container, service: str) -> None:
        """Start a container, and wait until it is ready where that is a service's."""
        plan = self._plan
        host = host_config(container, plan.limits)
        host["Init"] = plan.has_init
        if plan.has_quota:
            host["StorageOpt"] = {"size": f"{int(less(container.storage_mb, plan.limits.storage_mb))}m"}
        host["Mounts"] = [
            {"Type": "volume", "Source": self._volumes[volume], "Target": path}
            for volume, path in container.volumes.items()
        ]
        said = config(
            container, plan.images[service], labels("service" if service else "machine"), host, sleeps=not service
        )
        if self._network:
            aliases = [service] if service else list(_MAIN_NAMES)
            aliases += [container.hostname] if container.hostname else []
            said["NetworkingConfig"] = attached(said["HostConfig"], self._network, aliases)
        self._things.containers.append(name)
        client.make_container(said, name)
        client.start(name)
        if service and container.healthcheck is not None:
            wait_healthy(client, name, container.healthcheck, lambda: _ended(client, name, service))

    def _judge(
        self, machine: DockerMachine, network: Network | None, user: str, prepare: Prepare | None
    ) -> DockerMachine:
        """Commit a machine's files, and start a container with them that shares its network and process numbers.

        The numbers are not shared with programs of another user than root: those have none of the capabilities that
        keep the agent's processes, which can become any user, from looking into them.
        """
        plan, engine = self._plan, self._engine
        things = Things(engine)
        name = f"{machine.id}-judge-{secrets.token_hex(4)}"
        image = f"gem-terminal-judge:{name.removeprefix('gem-terminal-')}"
        # Tells its first process among all those that share the numbers.
        with self._links.untouched() as (client, untouched):
            sleep = program(client, untouched, "sleep")  # the agent may have put another of this name before it
        sleeps = (sleep, str(_draw.randrange(10**9, 2 * 10**9)))
        container = judge_of(plan.environment.main)
        try:
            with engine.asking("make a machine for the verifier") as client:
                things.images.append(image)
                repository, _, tag = image.partition(":")
                marks = labels("judge")
                # The label of the build is the committed container's as well: this is no image of the cache.
                said_labels = [f'LABEL {key}="{value}"' for key, value in marks.items()]
                with machine.parts.lock, frozen(engine, machine.id):  # so that both are of one moment
                    changed = changes(client, machine.id)
                    said_of = {"container": machine.id, "repo": repository, "tag": tag, "changes": said_labels}
                    client.ask("POST", "/commit", params=said_of, json={}, timeout=_COMMIT_S)
                host = host_config(container, plan.limits, powers=JUDGES)
                is_apart = not _is_root(user or str(client.inspect_container(machine.id)["Config"].get("User") or ""))
                if is_apart:
                    host["Init"] = plan.has_init
                else:
                    host["PidMode"] = f"container:{machine.id}"
                host["VolumesFrom"] = [machine.id]
                if plan.has_quota:
                    host["StorageOpt"] = {"size": f"{plan.limits.storage_mb}m"}
                said = config(container, image, marks, host, sleeps=True) | {"Cmd": list(sleeps)}
                self._join(client, said, machine, things, network)
                things.containers.append(name)
                client.make_container(said, name)
                parts = Parts(
                    engine,
                    name,
                    things,
                    Warden(engine, things, plan.images[""], name) if is_apart else machine.parts.warden,
                    self._links,
                    plan.base,
                    machine.parts.limits,
                    has_init=plan.has_init,
                    sleeps="" if is_apart else " ".join(sleeps),
                )
                parts.changed, parts.is_begun = changed, False
                if not is_apart:
                    parts.beside, parts.lock = machine.id, machine.parts.lock
                judge = DockerMachine(parts)
                if prepare is not None:
                    prepare(judge)
                with (
                    machine.parts.lock,
                    frozen(engine, machine.id),
                ):  # or a program that stops it would hold up the engine
                    client.start(name)
                if is_apart and plan.has_init and not engine.is_podman:
                    _wait_for_first(client, name)
                parts.is_begun = True
                judge.remove_emptied()
        except BaseException:
            things.remove()
            raise
        return judge

    def _join(
        self,
        client: Client,
        said: dict[str, Any],
        machine: DockerMachine,
        things: Things,
        network: Network | None,
    ) -> None:
        """Give a judge the network of its machine, or another, from which the machine's loopback is not reached."""
        host = said["HostConfig"]
        if network is None or network == self._plan.network:
            host["NetworkMode"] = f"container:{machine.id}"
        elif network == "public":
            name = f"{machine.id}-judge-{secrets.token_hex(4)}"
            things.networks.append(name)
            make_network(client, name, public=True)
            said["NetworkingConfig"] = attached(host, name, list(_MAIN_NAMES))
        elif network == "none":
            host["NetworkMode"] = "none"
        else:
            raise EngineError(
                "a verifier with a network of some hosts alone cannot be run: a container engine has no such network"
            )


def _is_root(user: str) -> bool:
    return user.partition(":")[0] in ("", "0", "root")


def _wait_for_first(client: Client, name: str) -> None:
    """Wait until the engine's first process has started the container's own.

    By then it is the oldest below it, and is told by that from whatever the agent starts.
    """
    deadline = time.monotonic() + _FIRST_S
    while time.monotonic() < deadline:
        if len(client.top(name, "-eo pid").get("Processes") or []) > 1:
            return
        if not client.inspect_container(name)["State"].get("Running"):
            break
        threading.Event().wait(0.01)
    raise MachineLostError("a container's command ended at once, or was not started", by_agent=False)


def wait_healthy(client: Client, name: str, check: Healthcheck, lost: Callable[[], MachineLostError | None]) -> None:
    """Wait until a container is ready.

    Raises:
        MachineLostError: It ended, or is not ready after all tries.
    """
    started = time.monotonic()
    failures = 0
    while True:
        exec_id = execute(client, name, Wish(check.command), tty=False, size=(0, 0))
        running = Running(client, exec_id, begin(client, exec_id, tty=False), 2000)
        try:
            running.begin()
        except StuckError:
            raise EngineError(f"the healthcheck {' '.join(check.command)!r} was not started by the engine") from None
        done = running.wait(check.timeout_s, lambda _: None)
        if done.exit_code == 0:
            return
        ended = lost()
        if ended is not None:
            raise MachineLostError(f"a container ended before it was ready: {ended}", by_agent=False)
        if time.monotonic() - started > check.start_period_s:
            failures += 1
        if failures >= max(check.retries, 1):
            said = " ".join(done.output.decode("utf-8", "replace").split())[-300:]
            raise MachineLostError(
                f"a container was not ready after {failures} tries of {' '.join(check.command)!r}: "
                f"{'it took too long' if done.exit_code is None else f'exit code {done.exit_code}'} {said}",
                by_agent=False,
            )
        threading.Event().wait(max(check.interval_s, 0.05))


def _ended(client: Client, name: str, service: str) -> MachineLostError | None:
    state = client.inspect_container(name)["State"]
    if state.get("Running"):
        return None
    return MachineLostError(f"the service {service!r} ended with exit code {state.get('ExitCode')}", by_agent=False)
