"""Images: built once for the same content, by one process at a time, and found again by their tags."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import stat
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import docker.errors

from gem_terminal.backends.docker.contexts import DOCKERFILE, Context, read_context
from gem_terminal.backends.docker.engine import FAILURES, Engine, is_full
from gem_terminal.backends.docker.labels import LABEL
from gem_terminal.backends.docker.stream import connection_of
from gem_terminal.errors import BuildError, EngineError

if TYPE_CHECKING:
    from gem_terminal.tasks.task import Container

REPOSITORY = "gem-terminal"
"""Images are ``gem-terminal:DIGEST``."""

_LOG_LINES = 40
_PULL = (
    "pull access denied",
    "manifest unknown",
    "no such host",
    "repository does not exist",
    "registry",
    "not found",
    "dial tcp",
)


class Images:
    """The images of an engine.

    Args:
        engine: The engine.
        build_args: Arguments of builds that overrule a task's own, where its Dockerfile declares them.
    """

    def __init__(self, engine: Engine, build_args: Mapping[str, str]) -> None:
        self._engine = engine
        self._build_args = dict(build_args)
        self._known: dict[Any, str] = {}
        self._locks: dict[str, threading.Lock] = {}
        self._lock = threading.Lock()

    def image(
        self,
        container: Container,
        key: str,
        *,
        timeout_s: float,
        fresh: bool = False,
        on_line: Callable[[str], None] | None = None,
    ) -> str:
        """Return the name of a container's image, built or pulled where it is not there.

        Args:
            container: What asks for it.
            key: Names the version of its task: as long as it is the same, the files are read once.
            timeout_s: Seconds that building may take.
            fresh: Build anew, without caches.
            on_line: Called with each line of the log.

        Raises:
            BuildError: It cannot be built.
            EngineError: It is not there and cannot be pulled, or the engine failed.
        """
        if container.context is None:
            return self._pulled(container.image or "", timeout_s, on_line, fresh=fresh)
        args = tuple(sorted(container.build_args.items()))
        known = (key, container.context, container.dockerfile, args, container.target)
        if not fresh and known in self._known:
            return self._known[known]
        if container.image is not None:
            try:
                return self._pulled(container.image, timeout_s, on_line, fresh=fresh)
            except EngineError as error:
                if on_line is not None:
                    on_line(f"building from {container.context / container.dockerfile} instead: {error}")
        context = read_context(container, self._build_args)
        name = f"{REPOSITORY}:{context.digest[:32]}"
        with self._one_builder(name):
            if fresh or not self.has(name):
                Build(self._engine, context, name, timeout_s, on_line).run(fresh=fresh)
        self._known[known] = name
        return name

    def names(self) -> list[str]:
        """Return the images that were asked for."""
        return sorted(set(self._known.values()))

    def forget(self) -> None:
        """Look for each image again when it is next asked for, as after one was removed."""
        self._known.clear()

    def has(self, name: str) -> bool:
        """Whether the engine has an image."""
        try:
            with self._engine.asking(f"look for the image {name!r}") as client:
                client.image(name)
        except docker.errors.NotFound:
            return False
        return True

    def identity(self, name: str) -> str:
        """Return what names an image for good, though its tag be removed or given to another.

        Raises:
            docker.errors.NotFound: It is not there.
        """
        with self._engine.asking(f"look for the image {name!r}") as client:
            return str(client.image(name)["Id"])

    def _pulled(self, name: str, timeout_s: float, on_line: Callable[[str], None] | None, *, fresh: bool) -> str:
        if not fresh and (name in self._known or self.has(name)):
            self._known[name] = name
            return name
        if on_line is not None:
            on_line(f"pulling {name}")
        repository, _, tag = name.partition("@") if "@" in name else name.rpartition(":")
        if not repository or "/" in tag:
            repository, tag = name, "latest"
        deadline = time.monotonic() + timeout_s
        try:
            with self._engine.asking(f"pull the image {name!r}") as client:
                for said in client.pull(repository, tag, stream=True, decode=True):
                    if said.get("error"):
                        raise EngineError(f"could not pull the image {name!r}: {said['error']}")
                    if time.monotonic() > deadline:
                        raise EngineError(f"could not pull the image {name!r} within {timeout_s:g} s")
        except (EngineError, docker.errors.NotFound) as error:
            if self.has(name):
                return name  # what is here serves, though there is no way to ask for a newer one
            advice = f"Run 'docker pull {name}', or 'docker load' it from a file"
            raise EngineError(f"the image {name!r} is not there ({error}). {advice}") from error
        return name

    @contextlib.contextmanager
    def _one_builder(self, name: str) -> Iterator[None]:
        """Let one thread of one process of this machine build an image; the others find it built."""
        with self._lock:
            lock = self._locks.setdefault(name, threading.Lock())
        with lock, shared_lock("building"), _file_lock(name.rpartition(":")[2], fcntl.LOCK_EX):
            yield


@contextlib.contextmanager
def shared_lock(name: str) -> Iterator[None]:
    """Hold a lock of this machine together with others that hold it so."""
    with _file_lock(name, fcntl.LOCK_SH):
        yield


@contextlib.contextmanager
def lock_alone(name: str) -> Iterator[bool]:
    """Take a lock of this machine that :func:`shared_lock` holds; gives whether nobody else has it, without waiting."""
    try:
        with _file_lock(name, fcntl.LOCK_EX | fcntl.LOCK_NB):
            yield True
    except BlockingIOError:
        yield False


@contextlib.contextmanager
def _file_lock(name: str, kind: int) -> Iterator[None]:
    folder = Path(tempfile.gettempdir()) / f"gem-terminal-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if status.st_uid != os.getuid() or not stat.S_ISDIR(status.st_mode):
        raise EngineError(f"{folder} belongs to someone else: remove it, or set TMPDIR to a folder of your own")
    # The file stays: to remove it would let two processes lock two files of one name.
    descriptor = os.open(folder / f"{name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, kind)
        yield
    finally:
        os.close(descriptor)


class Build:
    """One run of the engine's builder.

    Args:
        engine: The engine.
        context: What is built.
        name: What the image will be called.
        timeout_s: Seconds that it may take.
        on_line: Called with each line of the log.
    """

    def __init__(
        self, engine: Engine, context: Context, name: str, timeout_s: float, on_line: Callable[[str], None] | None
    ) -> None:
        self._engine = engine
        self._context = context
        self._name = name
        self._timeout_s = timeout_s
        self._on_line = on_line
        self._log: list[str] = []
        self._layers: list[str] = []
        self._late = False

    def run(self, *, fresh: bool) -> None:
        """Build the image.

        Args:
            fresh: Without the engine's cache.

        Raises:
            BuildError: It failed, or took too long.
        """
        params = {
            "t": self._name,
            "dockerfile": DOCKERFILE,
            "rm": True,
            "forcerm": True,
            "nocache": fresh,
            "buildargs": json.dumps(dict(self._context.args)),
            "labels": json.dumps({LABEL: "image"}),
            "target": self._context.target,
        }
        try:
            problem = self._stream({key: value for key, value in params.items() if value != ""})
        except BaseException:
            self._undo()
            raise
        if problem or self._late:
            self._undo()
            raise self._error(problem)

    def _stream(self, params: dict[str, Any]) -> str:
        """Run it, and return what the engine says is wrong; empty when all is well."""
        headers = {"Content-Type": "application/x-tar"}
        with self._engine.asking("build an image") as client, self._context.archive() as archive:
            client._set_auth_headers(headers)  # type: ignore[attr-defined]  # docker's client has no public way
            timeout_s = self._timeout_s + 10
            response = client.ask(
                "POST", "/build", data=archive, params=params, headers=headers, stream=True, timeout=timeout_s
            )
            with contextlib.closing(response):
                watch = threading.Timer(self._timeout_s, self._cut, [connection_of(response)])
                watch.daemon = True
                watch.start()
                try:
                    return self._follow(response.iter_lines())
                except FAILURES:
                    if not self._late:
                        raise
                    return ""
                finally:
                    watch.cancel()

    def _cut(self, connection: Any) -> None:
        """End the build: the engine does so when nobody listens any more."""
        self._late = True
        with contextlib.suppress(OSError):
            connection.shutdown(2)

    def _follow(self, lines: Iterator[bytes]) -> str:
        problem, done = "", False
        for line in lines:
            said = _read(line)
            text = str(said.get("stream") or said.get("status") or said.get("error") or "")
            for part in text.splitlines():
                self._note(part)
            problem = problem or str(said.get("error") or "")
            done = done or "aux" in said or text.startswith("Successfully built")
        return problem if problem or done else "the engine broke off"

    def _note(self, line: str) -> None:
        if not line.strip():
            return
        words = line.split()
        if len(words) == 2 and words[0] == "--->" and (not self._log or "Using cache" not in self._log[-1]):
            self._layers.append(words[1])
        self._log = [*self._log[-_LOG_LINES:], line.rstrip()[:2000]]
        if self._on_line is not None:
            self._on_line(line.rstrip())

    def _undo(self) -> None:
        """Remove the layers that a failed build has left, newest first; those that others use stay."""
        for layer in reversed(self._layers):
            try:
                with self._engine.asking("remove a layer") as client:
                    if LABEL in (client.image(layer)["Config"].get("Labels") or {}):
                        client.remove_image(layer)
            except (EngineError, docker.errors.NotFound):
                continue

    def _error(self, problem: str) -> BuildError:
        log = "\n".join(self._log)
        where = self._context.folder
        if self._late:
            what, advice = f"took longer than {self._timeout_s:g} s", "Raise the task's build_timeout_sec, or look why"
        elif is_full(ValueError(problem)):
            what, advice = problem, "The engine's disk is full: free space, or run 'gem terminal clean --images'"
        elif "buildkit" in problem.lower():
            what, advice = problem, "Its Dockerfile needs BuildKit: build it by hand, and name the image in the task"
        elif any(words in problem.lower() for words in _PULL) and "returned a non-zero code" not in problem:
            what = problem
            advice = "Its base image is not there: 'docker pull' it, or name one with GEM_TERMINAL_BASE_IMAGE"
        else:
            what, advice = problem, "Mend its Dockerfile"
        return BuildError(f"the image of {where} could not be built: {what}. {advice}. The end of the log:\n{log}", log)


def _read(line: bytes) -> dict[str, Any]:
    try:
        said = json.loads(line)
    except ValueError:
        return {}
    return said if isinstance(said, dict) else {}
