"""``LocalBackend``: machines without a container engine, each a bubblewrap sandbox over a folder on disk.

It is for a first look, and for tasks that are written for it: of an image, only ``setup/prepare.sh`` beside its
Dockerfile is run.
"""

from __future__ import annotations

import os
import resource
import tempfile
import threading
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from gem_terminal.backends.interface import Limits, Resources
from gem_terminal.backends.local.folders import MOUNTS, SKELETON, ProcessFolder, empty, sweep
from gem_terminal.backends.local.launch import Sandbox, check, probe, run_as_root
from gem_terminal.backends.local.machine import ROOT_USERS, LocalMachine
from gem_terminal.errors import BuildError, EngineError, MachineError, TaskError

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Container, Environment, Task

_SCRIPT = "setup/prepare.sh"
_SETUP = "/opt/setup"
_WORKDIR = "/app"
_PREPARE = f'mkdir -p -- "$1" && cd -- "$1" && exec sh /opt/{_SCRIPT}'
_SLEEPS = {"sleep", "/bin/sleep", "/usr/bin/sleep", "tail", "/usr/bin/tail"}
_BUILDING = Limits(memory_mb=4096, processes=1024, storage_mb=16_384)
_ENV = {
    "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    "HOME": "/root",
    "LANG": "C.UTF-8",
    "HOSTNAME": "terminal",
}


class LocalBackend:
    """Runs tasks that need no image of their own, on a Linux machine with bubblewrap.

    Args:
        folder: Where machines are kept; None for the folder for temporary files.
    """

    name = "local"
    weaker = (
        "a bubblewrap sandbox, not a container: it runs the programs that are installed on this machine, read-only, "
        "and sees this machine's kernel, processors and memory in /proc; root is the only user there is; memory and "
        "written files are limited for each process, not in all, and processor time is not"
    )

    def __init__(self, folder: Path | str | None = None) -> None:
        self._base = Path(folder or tempfile.gettempdir()).absolute()
        self._lock, self._building = threading.Lock(), threading.Lock()
        self._templates: dict[tuple[str, str], Path] = {}
        self._machines: set[LocalMachine] = set()
        self._folder: ProcessFolder | None = None
        self._removal: weakref.finalize[..., LocalBackend] | None = None

    def resources(self) -> Resources:
        """Return that nothing is known."""
        return Resources()

    def check(self, task: Task) -> None:
        """Raise when it cannot run a task at all; see ``Backend.check``."""
        self._check(task, "task")
        probe()

    def build(self, task: Task, *, fresh: bool = False, on_line: Callable[[str], None] | None = None) -> None:
        """Run ``prepare.sh`` of a task, whose files this process then keeps; see ``Backend.build``."""
        self._check(task, "none")
        for environment in _environments(task):
            self._template(task, environment, fresh=fresh, on_line=on_line)

    def start(self, task: Task, limits: Limits, *, environment: Environment | None = None) -> LocalMachine:
        """Start a machine that nothing has touched; see ``Backend.start``."""
        self._check(task, limits.network)
        wanted = environment or task.environment
        template = self._template(task, wanted)
        place = self._own_folder().new()
        if not run_as_root("cp", "-a", "--reflink=auto", f"{template}/.", str(place)):
            empty(place)
            raise EngineError(f"{template} cannot be copied: is there room left?")
        machine = self._machine(place, wanted.main, limits)
        command = wanted.main.command or ("sleep", "infinity")
        # A command that only keeps a container there is not needed, but by an entrypoint.
        if wanted.main.entrypoint or not {command[0], command[-1].split(" ")[0]} & _SLEEPS:
            machine.start_main((*(wanted.main.entrypoint or ()), *command))
        return machine

    def clean(self, *, images: bool = False) -> list[str]:
        """Remove what processes that are dead have left behind; there are no images that outlive their process."""
        del images
        return sweep(self._base)

    def close(self) -> None:
        """Remove every machine that this process has made; see ``Backend.close``."""
        with self._lock:
            removal, self._removal, self._folder = self._removal, None, None
            self._templates.clear()
        if removal is not None:
            removal()

    def _check(self, task: Task, network: str) -> None:
        check()
        lacking = [what for environment in _environments(task) for what in _lacking(environment, network)]
        for step in task.steps:
            if network == "task" and step.verifier.network not in ("none", None):
                lacking.append(f"the network {step.verifier.network!r} for its verifier")
            lacking += [
                f"the user {user!r}" for user in (step.agent_user, step.verifier.user) if user not in ROOT_USERS
            ]
        if lacking:
            raise TaskError(f"{task.name} needs Docker: it asks for {', '.join(dict.fromkeys(lacking))}")

    def _template(
        self,
        task: Task,
        environment: Environment,
        *,
        fresh: bool = False,
        on_line: Callable[[str], None] | None = None,
    ) -> Path:
        """Return the root folder that machines of an environment are copied from, made on first use."""
        key = (task.digest, os.path.relpath(environment.main.context or "", task.folder))
        with self._building:
            if fresh or key not in self._templates:
                self._templates[key] = self._prepared(task, environment, on_line)
            return self._templates[key]

    def _prepared(self, task: Task, environment: Environment, on_line: Callable[[str], None] | None) -> Path:
        place = self._own_folder().new()
        workdir = environment.main.workdir or _WORKDIR
        setup = Path(environment.main.context or task.folder, _SCRIPT).parent
        timeout_s = environment.build_timeout_s
        with self._machine(place, environment.main, _BUILDING, workdir="/", keep=True) as machine:
            try:
                machine.run(["sh", "-c", SKELETON], timeout_s=timeout_s)
                machine.put({_SETUP: setup})
                done = machine.run(["sh", "-c", _PREPARE, "sh", workdir], timeout_s=timeout_s)
                machine.remove_files([_SETUP])
            except MachineError as error:
                raise BuildError(f"the image of {task.name} was not built: {error}") from error
        log = done.output.decode("utf-8", "replace").strip()
        if on_line is not None:
            for line in log.splitlines():
                on_line(line)
        if done.exit_code == 0:
            return place
        ended = "took longer than its time (build_timeout_s)"
        if done.exit_code is not None:
            ended = f"ended with exit code {done.exit_code}"
        end = "\n".join(log.splitlines()[-20:])
        raise BuildError(f"the image of {task.name} was not built: {_SCRIPT} {ended}; the log ends with:\n{end}", log)

    def _machine(
        self, place: Path, container: Container, limits: Limits, *, workdir: str = "", keep: bool = False
    ) -> LocalMachine:
        """Start a machine over a root folder, which is removed with it unless it is to be kept."""

        def release() -> None:
            if not keep:
                empty(place)
            self._machines.discard(machine)

        try:
            sandbox = Sandbox(["--bind", str(place), "/", *MOUNTS], container.hostname or "terminal")
        except BaseException:
            empty(place)
            raise
        machine = LocalMachine(
            place.name,
            sandbox,
            env={**_ENV, **container.env},
            workdir=workdir or container.workdir or _WORKDIR,
            limits=_options(container, limits),
            release=release,
        )
        self._machines.add(machine)
        return machine

    def _own_folder(self) -> ProcessFolder:
        with self._lock:
            if self._folder is None:
                sweep(self._base)
                self._folder = ProcessFolder(self._base)
                # At exit, or before, when nobody has this any more.
                self._removal = weakref.finalize(self, _remove_all, self._machines, self._folder, os.getpid())
            return self._folder


def _remove_all(machines: set[LocalMachine], folder: ProcessFolder, pid: int) -> None:
    if os.getpid() == pid:  # a fork has no part in what is its parent's
        for machine in list(machines):
            machine.remove()
        folder.remove()


def _environments(task: Task) -> list[Environment]:
    own = [step.verifier.environment for step in task.steps if step.verifier.environment is not None]
    return [task.environment, *own]


def _lacking(environment: Environment, network: str) -> list[str]:
    """Return what an environment asks for that a sandbox lacks."""
    main = environment.main
    lacking = list(environment.unsupported)
    if main.context is None or not (main.context / _SCRIPT).is_file():
        lacking.append(f"an image of its own (beside its Dockerfile is no {_SCRIPT}, which a sandbox could run)")
    if environment.services:
        lacking.append(f"several containers ({', '.join(environment.services)})")
    asked = environment.network if network == "task" else network
    if asked not in ("none", None):
        lacking.append(f"the network {asked!r}")
    if main.user not in ROOT_USERS:
        lacking.append(f"the user {main.user!r}")
    if main.healthcheck is not None:
        lacking.append("a healthcheck of its container")
    return lacking


def _options(container: Container, limits: Limits) -> list[str]:
    """Return the limits of each program, as options of ``prlimit``."""
    share = limits.share(container)
    wanted = {
        "data": (resource.RLIMIT_DATA, int(share.memory_mb) << 20),
        "fsize": (resource.RLIMIT_FSIZE, int(share.storage_mb) << 20),
        "nproc": (resource.RLIMIT_NPROC, limits.processes),
    }
    most = {name: resource.getrlimit(kind)[1] for name, (kind, _) in wanted.items()}  # -1 is no limit
    return [f"--{name}={min(value, most[name] % (1 << 64))}" for name, (_, value) in wanted.items()]
