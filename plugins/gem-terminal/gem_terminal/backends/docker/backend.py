"""``DockerBackend``: machines from a container engine."""

from __future__ import annotations

import atexit
import contextlib
import os
import secrets
import threading
import time
import weakref
from collections.abc import Mapping
from typing import TYPE_CHECKING

import docker.errors

from gem_terminal.backends.docker.engine import FAILURES, Engine
from gem_terminal.backends.docker.images import Images
from gem_terminal.backends.docker.machine import DockerMachine
from gem_terminal.backends.docker.starting import network_of, start
from gem_terminal.backends.docker.sweeping import OWNER, Thing, owner, sweep
from gem_terminal.errors import EngineError, MachineError, MachineLostError, TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Limits, Resources
    from gem_terminal.tasks.task import Environment, Task

_BASE = "GEM_TERMINAL_BASE_IMAGE"
_LOOK_S, _MOST_LOOK_S = 2.0, 15.0
"""Seconds between two looks at what machines have written: an agent can write a gigabyte in a few. Where a look takes
long, it is five times as long until the next."""

_all: weakref.WeakSet[DockerBackend] = weakref.WeakSet()
_shared: dict[tuple[tuple[str, str], ...], DockerBackend] = {}
_sharing = threading.Lock()


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

    def __init__(self, base_url: str | None = None, build_args: Mapping[str, str] | None = None) -> None:
        base = os.environ.get(_BASE)
        self.engine = Engine(base_url)
        self.images = Images(self.engine, {**({"BASE": base} if base else {}), **(build_args or {})})
        self._lock = threading.Lock()
        self._pid = 0
        self._machines: dict[str, tuple[DockerMachine, float]] = {}
        """The machines that are not removed yet by their names, with the megabytes that each may write."""

        self._watching = False
        _all.add(self)

    def resources(self) -> Resources:
        """Return the processors and the memory of the engine's computer."""
        return self.engine.resources()

    def check(self, task: Task) -> None:
        """Raise when a task cannot be run at all."""
        environments = [task.environment, *(step.verifier.environment for step in task.steps)]
        missing = [what for environment in environments if environment for what in environment.unsupported]
        if missing:
            raise TaskError(
                f"the task {task.name!r} ({task.folder}) asks for what no engine here has: {'; '.join(missing)}"
            )
        self._begin()

    def start(self, task: Task, limits: Limits, *, environment: Environment | None = None) -> DockerMachine:
        """Build what is missing, and start a machine that nothing has touched, its healthchecks passed."""
        self._begin()
        environment = environment or task.environment
        network = network_of(task, environment, limits)
        images = {
            service: self.images.image(container, task, timeout_s=environment.build_timeout_s)
            for service, container in {**environment.services, "": environment.main}.items()
        }
        name = f"gem-terminal-{secrets.token_hex(8)}"
        things: list[Thing] = []
        there = self.resources()
        share = limits.share(environment.main, there)
        machine = DockerMachine(self.engine, name, things, share, limits.processes, self._forget)
        with self._lock:
            self._machines[name] = machine, share.storage_mb
        try:
            with self.engine.asking("start a machine") as client:
                start(client, name, things, environment, images, network, limits, there)
        except docker.errors.NotFound as error:
            machine.remove()
            raise EngineError(f"could not start a machine: {error.explanation or error}") from error
        except BaseException:
            machine.remove()
            raise
        self._watch()
        return machine

    def close(self) -> None:
        """Remove every machine that this process has made. May be called again; never raises."""
        self._remove_machines()
        with contextlib.suppress(*FAILURES):
            self.engine.close()

    def end(self) -> None:
        """Close it at the end of the interpreter, and remove what may have been made while a start was broken off."""
        if self._pid == os.getpid():
            self._remove_machines()
            with contextlib.suppress(MachineError):
                sweep(self.engine, owned_by=owner())
        self.close()

    def _remove_machines(self) -> None:
        for machine, _ in list(self._machines.values()):
            machine.remove()

    def _begin(self) -> None:
        """Connect to the engine; the first time in a process, have removed what dead processes have left."""
        _ = self.engine.client
        with self._lock:
            if self._pid == os.getpid():
                return
            self._pid = os.getpid()
            self._machines = {}  # those of a process that was forked are its parent's
            self._watching = False
        threading.Thread(target=self._sweep, name="gem-terminal-sweep", daemon=True).start()

    def _sweep(self) -> None:
        with contextlib.suppress(MachineError):
            sweep(self.engine)

    def _forget(self, machine: DockerMachine) -> None:
        with self._lock:
            self._machines.pop(machine.id, None)

    def _watch(self) -> None:
        with self._lock:
            if not self._watching:
                self._watching = True
                threading.Thread(target=self._keep_watching, name="gem-terminal-disk", daemon=True).start()

    def _keep_watching(self) -> None:
        """End machines that write more than they may, for as long as there are any.

        Docker itself can limit a container's files only where they are on XFS with project quotas (or on btrfs, ZFS). A
        single file cannot grow past the limit in any case.
        """
        took_s = 0.0
        while True:
            time.sleep(min(max(_LOOK_S, 5 * took_s), _MOST_LOOK_S))
            began = time.monotonic()
            with self._lock:
                if not self._machines:
                    self._watching = False
                    return
            with contextlib.suppress(MachineError, docker.errors.NotFound), self.engine.asking("look") as client:
                for row in client.containers(size=True, filters={"label": f"{OWNER}={owner()}"}):
                    machine, limit_mb = self._machines.get(str(row["Names"][0]).lstrip("/"), (None, 0.0))
                    written_mb = (row.get("SizeRw") or 0) / 2**20
                    if machine is not None and written_mb > limit_mb:
                        words = f"the machine wrote {written_mb:.0f} MB, more than its {limit_mb:g}"
                        machine.end(MachineLostError(words, by_agent=True))
            took_s = time.monotonic() - began


def shared_backend(build_args: Mapping[str, str] | None = None) -> DockerBackend:
    """Return the backend that all environments of this process share whose images get the same arguments.

    Raises:
        EngineError: No engine answers; says how to start one.
    """
    key = tuple(sorted((build_args or {}).items()))
    with _sharing:
        if key not in _shared:
            backend = DockerBackend(build_args=build_args)
            _ = backend.engine.client  # it connects, or says what is missing
            _shared[key] = backend
        return _shared[key]


def _after_fork() -> None:
    # Connections and machines are the parent's.
    global _sharing, _shared
    _sharing, _shared = threading.Lock(), {}


os.register_at_fork(after_in_child=_after_fork)


@atexit.register
def _end_all() -> None:
    for backend in list(_all):
        backend.end()
