"""Images: built by the command ``docker build`` once for the same content, and found again by their tags."""

from __future__ import annotations

import collections
import contextlib
import fcntl
import functools
import hashlib
import json
import logging
import os
import re
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING

import docker.errors

from gem_terminal.backends.docker.engine import Engine, is_full
from gem_terminal.backends.docker.sweeping import LABEL, REPOSITORY
from gem_terminal.errors import BuildError, EngineError

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Container, Task

logger = logging.getLogger(__name__)

_LOG_LINES = 40
_ARGUMENT = re.compile(r"^\s*ARG\s+([A-Za-z_][A-Za-z0-9_]*)", re.IGNORECASE | re.MULTILINE)
_MISSING = re.compile(
    r"pull access denied|manifest unknown|no such host|repository does not exist|registry|not found|dial tcp", re.I
)
_COMMAND_FAILED = re.compile(r"returned a non-zero code|did not complete successfully")


class Images:
    """The images of an engine.

    Args:
        engine: The engine.
        build_args: Arguments of builds that overrule a task's own, where its Dockerfile declares them.
    """

    def __init__(self, engine: Engine, build_args: Mapping[str, str]) -> None:
        self._engine = engine
        self._build_args = dict(build_args)
        self.built: set[str] = set()
        """Names of the images that were asked for and are built from a Dockerfile."""

    def image(self, container: Container, task: Task, *, timeout_s: float) -> str:
        """Return the name of a container's image, built or pulled where it is not there.

        Args:
            container: What asks for it.
            task: Its task, whose digest stands for the files of the build.
            timeout_s: Seconds that building may take.

        Raises:
            BuildError: It cannot be built.
            EngineError: It is not there and cannot be pulled, or the engine failed.
        """
        if container.image is not None:
            try:
                return self._pulled(container.image, timeout_s)
            except EngineError as error:
                if container.context is None:
                    raise
                logger.info("gem-terminal: %s; building from %s", error, container.context / container.dockerfile)
        folder = container.context or Path(".")
        below = os.path.relpath(folder, task.folder)
        what = [task.digest, below, container.dockerfile, container.build_args, container.target, self._build_args]
        digest = hashlib.sha256(json.dumps(what, sort_keys=True).encode("utf-8", "surrogatepass")).hexdigest()[:32]
        name = f"{REPOSITORY}:{digest}"
        self.built.add(name)
        if self._has(name):
            return name
        with _one_builder(digest):
            if not self._has(name):
                words = ["--file", str(folder / container.dockerfile), "--tag", name, "--label", f"{LABEL}=image"]
                words += [
                    word for n, v in self._args(container, folder).items() for word in ("--build-arg", f"{n}={v}")
                ]
                words += ["--target", container.target] if container.target else []
                _build(self._engine, [*words, str(folder)], folder, timeout_s)
        return name

    def _args(self, container: Container, folder: Path) -> dict[str, str]:
        dockerfile = folder / container.dockerfile
        try:
            declared = set(_ARGUMENT.findall(dockerfile.read_text("utf-8", "surrogateescape")))
        except OSError as error:
            raise BuildError(f"the files of an image cannot be read: {error}. Look at {dockerfile}") from error
        return dict(container.build_args) | {n: v for n, v in self._build_args.items() if n in declared}

    def _has(self, name: str) -> bool:
        try:
            with self._engine.asking(f"look for the image {name!r}") as client:
                client.ask("GET", f"/images/{name}/json")
        except docker.errors.NotFound:
            return False
        return True

    def _pulled(self, name: str, timeout_s: float) -> str:
        if self._has(name):
            return name
        deadline = time.monotonic() + timeout_s
        repository, tag = docker.utils.parse_repository_tag(name)
        try:
            with self._engine.asking(f"pull the image {name!r}") as client:
                for said in client.pull(repository, tag or "latest", stream=True, decode=True):
                    if said.get("error"):
                        raise EngineError(f"could not pull the image {name!r}: {said['error']}")
                    if time.monotonic() > deadline:
                        raise EngineError(f"could not pull the image {name!r} within {timeout_s:g} s")
        except (EngineError, docker.errors.NotFound) as error:
            advice = f"Run 'docker pull {name}', or 'docker load' it from a file"
            raise EngineError(f"the image {name!r} is not there ({error}). {advice}") from error
        return name


@contextlib.contextmanager
def _one_builder(name: str) -> Iterator[None]:
    """Let one thread of one of this user's processes build an image; the others wait, and find it built."""
    folder = Path(tempfile.gettempdir()) / f"gem-terminal-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise EngineError(f"{folder} belongs to someone else: remove it, or set TMPDIR to a folder of your own")
    # The file stays: to remove it would let two processes lock two files of one name.
    with open(folder / f"{name}.lock", "wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@functools.cache
def builder(podman: bool) -> tuple[tuple[str, ...], Mapping[str, str]]:
    """Return the command that builds images, and variables for it.

    BuildKit is used where Docker's client has buildx: a client without (as Debian's) then has the classic builder.

    Raises:
        EngineError: There is none; says what to install.
    """
    program = which("docker")
    if program is None and podman and (program := which("podman")):
        return (program, "--remote", "build"), {}
    if program is None:
        raise EngineError(
            "images are built with the command 'docker', which is not there: install Docker's client "
            "(docker-ce-cli or docker.io), or build the images elsewhere and 'docker load' them"
        )
    if podman:
        return (program, "build", "--force-rm"), {"DOCKER_BUILDKIT": "0"}
    has_buildx = subprocess.run([program, "buildx", "version"], capture_output=True, check=False).returncode == 0
    if has_buildx:
        return (program, "buildx", "build", "--load", "--progress=plain"), {}
    return (program, "build", "--force-rm"), {}


def _build(engine: Engine, words: list[str], folder: Path, timeout_s: float) -> None:
    """Run the build.

    Raises:
        BuildError: It failed, or took too long.
    """
    command, more = builder(engine.is_podman)
    log: collections.deque[str] = collections.deque(maxlen=_LOG_LINES)
    late = threading.Event()
    with subprocess.Popen(
        [*command, *words],
        env=engine.variables | dict(more),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    ) as process:

        def kill() -> None:
            # Its connection ends with it, by which the engine's builder ends what it runs.
            late.set()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)

        watch = threading.Timer(timeout_s, kill)
        watch.daemon = True
        watch.start()
        try:
            for line in process.stdout or ():
                if text := line.decode("utf-8", "replace").rstrip():
                    log.append(text[:2000])
        except BaseException:
            kill()
            raise
        finally:
            watch.cancel()
    problem = next((line for line in reversed(log) if line.startswith("ERROR")), log[-1] if log else "it was killed")
    advice = _advice(problem)
    if late.is_set():
        problem, advice = f"took longer than {timeout_s:g} s", "Raise the task's build_timeout_sec, or look why"
    if process.returncode or late.is_set():
        text = "\n".join(log)
        raise BuildError(
            f"the image of {folder} could not be built: {problem}. {advice}. The end of the log:\n{text}", text
        )


def _advice(problem: str) -> str:
    if is_full(problem):
        return "The engine's disk is full: free space ('docker system df')"
    if "buildkit" in problem.lower():
        return "Its Dockerfile needs BuildKit: install the plugin buildx of Docker's client"
    if _MISSING.search(problem) and not _COMMAND_FAILED.search(problem):
        return "Its base image is not there: 'docker pull' it, or name one with GEM_TERMINAL_BASE_IMAGE"
    return "Mend its Dockerfile"
