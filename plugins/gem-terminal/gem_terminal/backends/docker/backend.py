"""``DockerBackend``: machines from a container engine."""

from __future__ import annotations

import contextlib
import os
import secrets
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

import docker.errors

from gem_terminal.backends.docker.containers import less
from gem_terminal.backends.docker.disk import DiskWatch
from gem_terminal.backends.docker.engine import FAILURES, Client, Engine
from gem_terminal.backends.docker.files import Links
from gem_terminal.backends.docker.images import Images
from gem_terminal.backends.docker.labels import labels
from gem_terminal.backends.docker.machine import DockerMachine, discard_left
from gem_terminal.backends.docker.networks import network_of
from gem_terminal.backends.docker.reaper import Reaping, reap
from gem_terminal.backends.docker.starting import Plan, Starter
from gem_terminal.backends.docker.things import Things
from gem_terminal.errors import EngineError, TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Limits
    from gem_terminal.tasks.task import Container, Environment, Network, Task

_REAP_S = 20.0
_BASE = "GEM_TERMINAL_BASE_IMAGE"


class DockerBackend:
    """Machines from Docker, or from Podman's socket of the same kind.

    Args:
        base_url: Where the engine is, as ``unix:///run/user/1000/podman/podman.sock``; None looks at DOCKER_HOST, the
            context of Docker's client, Docker's usual socket, and Podman's, in this order.
        build_args: Arguments of builds that overrule a task's own, where its Dockerfile declares them. The variable
            GEM_TERMINAL_BASE_IMAGE stands for ``{"BASE": …}``.

    Source: the Docker Engine API, version 1.40 and later.
    """

    name = "docker"
    weaker = ""

    def __init__(self, base_url: str | None = None, build_args: Mapping[str, str] | None = None) -> None:
        base = os.environ.get(_BASE)
        self.engine = Engine(base_url)
        self.images = Images(self.engine, {**({"BASE": base} if base else {}), **(build_args or {})})
        self._disk = DiskWatch()
        self._lock = threading.Lock()
        self._links: dict[str, Links] = {}
        self._machines: weakref.WeakSet[DockerMachine] = weakref.WeakSet()
        self._reaped_in = 0
        self._has_quota: bool | None = None

    def check(self, task: Task) -> None:
        """Raise when a task cannot be run at all."""
        environments = [task.environment, *(step.verifier.environment for step in task.steps)]
        missing = [what for environment in environments if environment for what in environment.unsupported]
        if missing:
            raise TaskError(
                f"the task {task.name!r} ({task.folder}) asks for what no engine here has: {'; '.join(missing)}"
            )
        self._ready()

    def build(self, task: Task, *, fresh: bool = False, on_line: Callable[[str], None] | None = None) -> None:
        """Make the images of a task, unless those of the same content are there."""
        self._ready()
        for environment in [task.environment, *(step.verifier.environment for step in task.steps)]:
            if environment is not None:
                self._build(task, environment, fresh=fresh, on_line=on_line)

    def start(self, task: Task, limits: Limits, *, environment: Environment | None = None) -> DockerMachine:
        """Build what is missing, and start a machine that nothing has touched, its healthchecks passed."""
        self._ready()
        wanted = environment or task.environment
        network = network_of(task, wanted, limits)
        try:
            plan = self._plan(task, wanted, limits, network)
            machine = Starter(self.engine, plan, self._links_of(plan.base)).start()
        except (EngineError, docker.errors.NotFound) as error:
            if "no such image" not in str(error).lower():
                raise
            # Someone has removed it since it was last looked for.
            self.images.forget()
            plan = self._plan(task, wanted, limits, network)
            machine = Starter(self.engine, plan, self._links_of(plan.base)).start()
        self._machines.add(machine)
        if not plan.has_quota:
            self._disk.add(machine, less(wanted.main.storage_mb, limits.storage_mb))
        return machine

    def clean(self, *, images: bool = False) -> list[str]:
        """Remove what processes that are dead have left behind, and on demand every image that was built."""
        discard_left()
        removed = reap(self.engine, images=images)
        if images:
            self.images.forget()
        return removed

    def close(self) -> None:
        """Remove every machine that this process has made. May be called again; never raises."""
        self._disk.close()
        for machine in list(self._machines):
            machine.remove()
        discard_left()
        with contextlib.suppress(*FAILURES):
            self.engine.close()

    def _ready(self) -> None:
        """See to it that the engine is there, and remove once what dead processes have left."""
        client = self.engine.client
        with self._lock:
            if self._reaped_in == os.getpid():
                return
            if os.getpid() != self._reaped_in and self._reaped_in:
                self._disk = DiskWatch()  # threads do not survive a fork
                self._machines = weakref.WeakSet()
            self._reaped_in = os.getpid()
        del client
        Reaping(self.engine).wait(_REAP_S)

    def _build(
        self,
        task: Task,
        environment: Environment,
        *,
        fresh: bool = False,
        on_line: Callable[[str], None] | None = None,
    ) -> dict[str, str]:
        def image(container: Container) -> str:
            timeout_s = environment.build_timeout_s
            return self.images.image(container, task.digest, timeout_s=timeout_s, fresh=fresh, on_line=on_line)

        images = {name: image(container) for name, container in environment.services.items()}
        return {**images, "": image(environment.main)}

    def _plan(self, task: Task, environment: Environment, limits: Limits, network: Network) -> Plan:
        images = self._build(task, environment)
        base = self.images.identity(images[""])
        return Plan(environment, images, base, limits, network, has_quota=self._quota(base), has_init=True)

    def _links_of(self, image: str) -> Links:
        with self._lock:
            return self._links.setdefault(image, Links(lambda: self._untouched(image)))

    @contextlib.contextmanager
    def _untouched(self, image: str) -> Iterator[tuple[Client, str]]:
        """Make a container of an image that never runs, to look at its files."""
        things = Things(self.engine)
        name = f"gem-terminal-{secrets.token_hex(8)}"
        things.containers.append(name)
        said = {"Image": image, "Labels": labels("look"), "Cmd": ["true"], "HostConfig": {"NetworkMode": "none"}}
        try:
            with self.engine.asking("look at an image") as client:
                client.make_container(said, name)
                yield client, name
        finally:
            things.remove()

    def _quota(self, image: str) -> bool:
        """Whether the engine can limit what a container writes; tried once."""
        with self._lock:
            if self._has_quota is not None:
                return self._has_quota
        things = Things(self.engine)
        name = f"gem-terminal-{secrets.token_hex(8)}"
        things.containers.append(name)
        host = {"NetworkMode": "none", "StorageOpt": {"size": "64m"}}
        try:
            with self.engine.asking("find out what the engine can limit") as client:
                said = {"Image": image, "Labels": labels("look"), "Cmd": ["true"], "HostConfig": host}
                client.make_container(said, name)
            has_quota = True
        except docker.errors.NotFound as error:
            raise EngineError(f"could not start a machine: {error.explanation or error}") from error
        except EngineError as error:
            if "storage" not in str(error).lower() and "quota" not in str(error).lower():
                raise
            has_quota = False
        finally:
            things.remove()
        with self._lock:
            self._has_quota = has_quota
        return has_quota
