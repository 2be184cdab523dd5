"""``LocalBackend``: machines without a container engine, each a bubblewrap sandbox over a folder on disk."""

from __future__ import annotations

import atexit
import hashlib
import json
import os
import secrets
import threading
import time
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from gem_terminal.backends.interface import Limits
from gem_terminal.backends.local import building, launch, recipe
from gem_terminal.backends.local.machine import LocalMachine, Surroundings
from gem_terminal.backends.local.scratch import Scratch, remove
from gem_terminal.backends.local.starting import Bounds, Machines
from gem_terminal.errors import BuildError, EngineError, MachineLostError, TaskError

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Container, Environment, Healthcheck, Task

_LAYOUT = 2  # goes up whenever templates are made in another way
_ROOT = ("", "root", "0", "root:root", "0:0")
_HELD = ("none", None)
_SLEEPS = ("sleep", "/bin/sleep", "/usr/bin/sleep", "tail", "/usr/bin/tail")


class LocalBackend:
    """Runs tasks that need no image of their own, on a Linux machine with bubblewrap.

    Args:
        folder: Where machines and templates are kept; None for ``gem-terminal-UID`` in the folder for temporary files.
        build_args: Arguments of all builds, which come before a task's own.
    """

    name = "local"
    weaker = (
        "a bubblewrap sandbox, not a container: it runs the programs that are installed on this machine, read-only, "
        "and sees this machine's kernel, processors and memory in /proc; root is the only user there is; memory and "
        "files are watched rather than capped, and there is no limit of processor time"
    )

    def __init__(self, folder: Path | str | None = None, *, build_args: Mapping[str, str] | None = None) -> None:
        self._scratch = Scratch(folder)
        self._machines = Machines(self._scratch)
        self._build_args = dict(build_args or {})
        self._cleaned = False
        self._lock = threading.Lock()
        self._process = os.getpid()
        _close_at_exit(self)

    def check(self, task: Task) -> None:
        """Raise when it cannot run a task at all.

        Raises:
            TaskError: The task asks for what a sandbox does not have; says what.
            EngineError: Bubblewrap is missing, or may not make sandboxes; says what to do.
        """
        self._check(task, "task")
        launch.probe()

    def build(self, task: Task, *, fresh: bool = False, on_line: Callable[[str], None] | None = None) -> None:
        """Make the templates of a task, unless those of the same content are there.

        Args:
            task: The task.
            fresh: Build anew.
            on_line: Called with each line of the log.

        Raises:
            BuildError: A command of its Dockerfile failed, or took longer than the task allows.
            TaskError: The task needs an image of its own.
            EngineError: There is no bubblewrap.
        """
        self._check(task, "none")
        for environment in _environments(task):
            self._template(task, environment, fresh=fresh, on_line=on_line)

    def start(self, task: Task, limits: Limits, *, environment: Environment | None = None) -> LocalMachine:
        """Build what is missing, and start a machine that nothing has touched, its healthcheck passed.

        Args:
            task: The task.
            limits: What it may take; processors are not limited.
            environment: Another environment than the task's, as one of a verifier's own.

        Raises:
            BuildError, TaskError, EngineError, MachineLostError: It could not be started.
        """
        self._check(task, limits.network)
        self._clean_once()
        wanted = environment or task.environment
        main = wanted.main
        template, baseline = self._template(task, wanted)
        made = recipe.of(main, self._build_args)
        surroundings = Surroundings({**_base_env(), **made.env, **main.env}, main.workdir or made.workdir)
        with self._scratch.locked(template.parent.with_suffix(".lock"), shared=True):
            if not template.is_dir():
                raise EngineError(f"the template of {task.name} was removed while a machine was to start: try again")
            machine = self._machines.start(
                surroundings,
                _bounds(main, limits),
                template=template,
                baseline_kb=baseline,
                hostname=main.hostname or "terminal",
            )
        try:
            _run_main(machine, main, made)
            if main.healthcheck is not None:
                _wait_until_healthy(machine, main.healthcheck, task.name)
        except BaseException:
            machine.remove()
            raise
        return machine

    def clean(self, *, images: bool = False) -> list[str]:
        """Remove what processes that are dead have left behind.

        Args:
            images: Also remove every template that no machine is being started from.

        Returns:
            What was removed, a line each.
        """
        return self._scratch.clean(images=images)

    def close(self) -> None:
        """Remove every machine that this process has made. May be called again; never raises."""
        if os.getpid() == self._process:
            self._machines.close()

    def _check(self, task: Task, network: str) -> None:
        launch.check()
        for environment in _environments(task):
            _check_environment(task, environment, network)
            recipe_of = recipe.of(environment.main, self._build_args)
            if environment.main.context is not None and recipe_of.steps:
                building.check_readable(environment.main.context)
        for step in task.steps:
            asked = step.verifier.network
            if network == "task" and asked not in _HELD:
                raise TaskError(f"{task.name}: its verifier asks for the network {asked!r}: use the backend 'docker'")
            for user in (step.agent_user, step.verifier.user):
                if user not in _ROOT:
                    raise TaskError(f"{task.name}: it asks for the user {user!r}: use the backend 'docker'")

    def _clean_once(self) -> None:
        """Remove what dead processes have left, when the first machine starts."""
        with self._lock:
            first, self._cleaned = not self._cleaned, True
        if first:
            self.clean()

    def _template(
        self,
        task: Task,
        environment: Environment,
        *,
        fresh: bool = False,
        on_line: Callable[[str], None] | None = None,
    ) -> tuple[Path, int]:
        """Return the template of an environment, made where it is missing, and its size in kilobytes."""
        self._scratch.open()
        key = self._key(task, environment.main)
        place = self._scratch.templates / key
        size = place / "size"
        # Those that copy it hold the lock together: whoever finds it made does not wait until they are done.
        with self._scratch.locked(place.with_suffix(".lock"), shared=True, wait=False) as free:
            if free and not fresh and size.is_file():
                return place / "root", int(size.read_text("ascii"))
        with self._scratch.locked(place.with_suffix(".lock")):
            if fresh:
                remove(place)
            if not size.is_file():
                self._make_template(task, environment, place, on_line)
            return place / "root", int(size.read_text("ascii"))

    def _make_template(
        self, task: Task, environment: Environment, place: Path, on_line: Callable[[str], None] | None
    ) -> None:
        main = environment.main
        made = recipe.of(main, self._build_args)
        deadline = time.monotonic() + environment.build_timeout_s
        keep: list[Path] = []
        half = place.with_suffix(f".{secrets.token_hex(4)}")
        bounds = _bounds(main, Limits(memory_mb=4096, processes=1024, storage_mb=16_384))
        log = building.Log(on_line)
        machine = self._machines.start(Surroundings(_base_env(), "/"), bounds, keep=keep)
        try:
            builder = building.Builder(machine, task.name, main.context, main.dockerfile, deadline, log)
            builder.follow(made.steps)
            size = building.baseline_kb(machine)
            half.mkdir(mode=0o711)
            (half / "size").write_text(str(size), "ascii")
            keep.append(half / "root")
        except (MachineLostError, EngineError, OSError) as error:
            raise BuildError(f"the image of {task.name} was not built: {error}", log.end) from error
        finally:
            machine.remove()
        os.rename(half, place)

    def _key(self, task: Task, container: Container) -> str:
        """Return the name of a template: everything that it depends on, hashed."""
        context = container.context
        if context is not None and context.is_relative_to(task.folder):
            context = context.relative_to(task.folder)
        parts = [
            *(_LAYOUT, task.digest, str(context), container.dockerfile, container.image),
            *(sorted(container.build_args.items()), sorted(self._build_args.items()), launch.python(), launch.uid()),
        ]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:40]


def _environments(task: Task) -> list[Environment]:
    own = [step.verifier.environment for step in task.steps if step.verifier.environment is not None]
    return [task.environment, *own]


def _check_environment(task: Task, environment: Environment, network: str) -> None:
    """Raise when a task asks for what a sandbox lacks, its image apart."""
    lacking = list(environment.unsupported)
    if environment.services:
        lacking.append(f"several containers ({', '.join(environment.services)})")
    asked = environment.network if network == "task" else network
    if asked not in _HELD:
        lacking.append(f"the network {asked!r}")
    if environment.main.user not in _ROOT:
        lacking.append(f"the user {environment.main.user!r}")
    if environment.main.target:
        lacking.append(f"a stage of its Dockerfile ({environment.main.target})")
    if lacking:
        raise TaskError(f"{task.name} asks for {', '.join(lacking)}, which a sandbox lacks: use the backend 'docker'")


def _bounds(container: Container, limits: Limits) -> Bounds:
    memory = min(limits.memory_mb, container.memory_mb or limits.memory_mb)
    storage = min(limits.storage_mb, container.storage_mb or limits.storage_mb)
    return Bounds(memory, limits.processes, storage, container.shm_mb or 64)


def _base_env() -> dict[str, str]:
    env = {"PATH": recipe.PATH, "HOME": "/root", "LANG": "C.UTF-8", "HOSTNAME": "terminal"}
    if launch.python().startswith(launch.PYTHON) and launch.libraries():
        env["LD_LIBRARY_PATH"] = launch.libraries()
    return env


def _run_main(machine: LocalMachine, container: Container, made: recipe.Recipe) -> None:
    """Start what a container would have as its first program, unless that only keeps the container there."""
    entrypoint = made.entrypoint if container.entrypoint is None else container.entrypoint
    words = (*entrypoint, *(container.command or ()))
    if not entrypoint and container.command is None:
        return
    if entrypoint and container.command is None:
        words = (*entrypoint, "sleep", "infinity")
    last = words[-1] if len(words) == 3 and words[1] == "-c" else " ".join(words)
    if last.split(" ", 1)[0] not in _SLEEPS:
        machine.start_main(words)


def _wait_until_healthy(machine: LocalMachine, healthcheck: Healthcheck, name: str) -> None:
    """Try a healthcheck until it passes.

    Raises:
        EngineError: It does not.
    """
    began = time.monotonic()
    failures = 0
    pause = threading.Event()
    while True:
        done = machine.run(healthcheck.command, timeout_s=healthcheck.timeout_s)
        if done.exit_code == 0:
            return
        if time.monotonic() - began >= healthcheck.start_period_s:
            failures += 1
        if failures >= max(1, healthcheck.retries):
            said = done.output.decode("utf-8", "replace").strip()[-300:]
            raise EngineError(f"{name}: its healthcheck {' '.join(healthcheck.command)!r} does not pass: {said}")
        pause.wait(healthcheck.interval_s)


def _close_at_exit(backend: LocalBackend) -> None:
    """Close a backend that is still there when the interpreter ends, without keeping it there until then."""
    reference = weakref.ref(backend)

    def close() -> None:
        found = reference()
        if found is not None:
            found.close()

    atexit.register(close)
    weakref.finalize(backend, atexit.unregister, close).atexit = False
