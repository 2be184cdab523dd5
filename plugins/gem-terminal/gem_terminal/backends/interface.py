"""What a backend offers: machines, each with its terminal, its files and its processes.

``Backend`` makes a ``Machine`` for an episode; ``Machine`` runs commands and opens a ``Terminal``. What happens in a
terminal (``shell.py``), what is verified (``verifying/``) and which machines are kept ready (``pool.py``) is written on
these alone, so that a backend is nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, Protocol, Self

if TYPE_CHECKING:
    from gem_terminal.errors import MachineLostError
    from gem_terminal.tasks.task import Container, Environment, Task


class Resources(NamedTuple):
    """Processors, and megabytes (2**20 bytes) of memory and of files."""

    cpus: float = inf
    memory_mb: float = inf
    storage_mb: float = inf


_USUAL = Resources(1.0, 2048, 4096)
"""What a container gets whose task asks for nothing."""


@dataclass(frozen=True)
class Limits:
    """What each container of a machine may take. With None, that is what its task asks for.

    Args:
        cpus: Processors; a task that asks for fewer gets fewer, and so on below.
        memory_mb: Megabytes (2**20 bytes) of memory, without swap.
        processes: Processes and threads at once.
        storage_mb: Megabytes written to its files.
        network: ``"task"`` gives what the task asks for, and none where it says nothing; ``"none"`` and ``"public"``
            overrule it.
    """

    cpus: float | None = None
    memory_mb: int | None = None
    processes: int = 1024
    storage_mb: int | None = None
    network: str = "task"

    def share(self, container: Container, there: Resources = Resources()) -> Resources:  # noqa: B008 - immutable
        """Return what a container gets.

        Args:
            container: What its task asks for.
            there: What the computer has.
        """
        most = Resources(*(inf if limit is None else limit for limit in self._resources()))
        usual = (limit or usual for limit, usual in zip(self._resources(), _USUAL, strict=True))
        asked = (asked or usual for asked, usual in zip(_asked(container), usual, strict=True))
        return Resources(*map(min, asked, most, there))

    def shortfall(self, task: Task, there: Resources) -> list[str]:
        """Return what the containers of a task ask for and do not get, in words."""
        found = []
        for service, container in {"": task.environment.main, **task.environment.services}.items():
            for (option, what), asked, given, limit in zip(
                _WORDS, _asked(container), self.share(container, there), self._resources(), strict=True
            ):
                if asked is not None and given < asked:
                    why = "what the engine's computer has" if limit is None or given < limit else f"{option}={limit:g}"
                    of = f"the service {service!r}" if service else "the task"
                    found.append(f"{of} asks for {asked:g} {what} and gets {given:g}: {why}")
        return found

    def _resources(self) -> tuple[float | None, ...]:
        return self.cpus, self.memory_mb, self.storage_mb


_WORDS = (("cpus", "processors"), ("memory_mb", "MB of memory"), ("storage_mb", "MB of storage"))


def _asked(container: Container) -> tuple[float | None, ...]:
    return container.cpus, container.memory_mb, container.storage_mb


@dataclass(frozen=True)
class Completed:
    """What a command did that ran to its end.

    Args:
        exit_code: Its exit code; 128 and the signal's number where a signal ended it; None where time ran out, and all
            that it had started was killed.
        output: Standard output and error together, as they came; cut in the middle beyond what was asked for.
        dropped: Bytes that were cut out.
    """

    exit_code: int | None
    output: bytes
    dropped: int = 0


@dataclass(frozen=True)
class Process:
    """A process of a machine, as ``/proc`` shows it there.

    Args:
        pid: Its number, as its own machine counts.
        parent: Its parent's.
        started: Clock ticks since the start of the system; with ``pid`` it names the process.
        command: Its command line, cut to 200 characters.
        session: The session it belongs to.
    """

    pid: int
    parent: int
    started: int
    command: str
    session: int


class Terminal(Protocol):
    """A program in a pseudo-terminal of a machine. Not for several threads at once.

    Reading (when all that it wrote was read) and writing raise ``MachineLostError`` once the program has ended, or the
    machine is gone.
    """

    @property
    def pid(self) -> int:
        """The program's process number, as its own machine counts."""

    def read(self, timeout_s: float) -> bytes:
        """Return what the program wrote, as soon as there is something; ``b""`` when ``timeout_s`` has passed."""

    def write(self, data: bytes) -> None:
        """Type. Never blocks for longer than a few seconds, though nobody reads: what was not taken is dropped."""

    def close(self) -> None:
        """Close it; the program gets a hang-up, at the latest before the machine runs anything else as root."""


class Machine(Protocol):
    """The containers of one episode. Its methods may be called from several threads.

    Where the machine is gone they raise ``MachineLostError``, and where the engine does not answer ``EngineError``.
    Paths are absolute paths in the machine. A file system that is full is a loss by the agent.
    """

    id: str
    """Names it in messages and to the engine."""

    def open_terminal(
        self,
        command: Sequence[str],
        *,
        user: str = "",
        workdir: str = "",
        env: Mapping[str, str] | None = None,
        columns: int = 120,
        lines: int = 40,
    ) -> Terminal:
        """Start a program in a pseudo-terminal, with the environment of the container and ``env``.

        Raises:
            MachineLostError: The program is not there.
        """

    def run(
        self,
        command: Sequence[str],
        *,
        user: str = "",
        workdir: str = "",
        env: Mapping[str, str] | None = None,
        timeout_s: float,
        most_output: int = 1_000_000,
    ) -> Completed:
        """Run a command without a terminal and without input, and wait for it to end.

        When ``timeout_s`` has passed it is killed, with all processes that have come up since it began below it. It
        ends with the command itself: what goes on in the background, and holds its output open, is not waited for.
        """

    def put(self, files: Mapping[str, Path | bytes | None], *, mode: int | None = None) -> None:
        """Write files, and folders with all that is in them, as root; what is there is replaced, folders whole.

        A symbolic link at a path is replaced, one on the way to it followed.

        Args:
            files: Host files and folders, or contents, by absolute paths in the machine; None for an empty folder in
                which every user may write.
            mode: Permissions of files; None keeps those of the host's, readable by all.
        """

    def get(self, path: str, *, most_bytes: int = 10_000_000) -> dict[str, bytes]:
        """Return the regular files at ``path``, a file or a folder, by path relative to it; a file is under ``""``.

        A link at the path or below it is not followed, and files beyond ``most_bytes`` in all are left out.
        """

    def save(self, path: str, file: BinaryIO, *, most_bytes: int) -> bool:
        """Write a tar archive of a file or folder, with owners, permissions and links; False when there is none.

        Its members are named after the last part of the path. A link at the path itself is followed.

        Raises:
            MachineLostError: The archive is larger than ``most_bytes``, which is a loss by the agent.
        """

    def load(self, path: str, file: BinaryIO) -> None:
        """Unpack an archive of ``save``, read from where it stands, at a path; what is there is replaced."""

    def remove_files(self, paths: Sequence[str]) -> None:
        """Remove files and folders, following no link at a path; what is not there is no error."""

    def processes(self) -> list[Process]:
        """Return all processes but those that the backend itself needs to keep the machine.

        A backend may have to end all of them, where the agent has used up those that there may be.
        """

    def kill(self, processes: Sequence[Process]) -> None:
        """Kill processes with SIGKILL; one that has ended, or whose number is another's by now, is left alone."""

    def make_room(self) -> None:
        """Allow a few more processes, and a little more memory, than its limits: for a shell that is to start anew.

        Without, what the agent has left running might keep it from starting. Where that cannot be, nothing happens.
        """

    def why_lost(self) -> MachineLostError | None:
        """Return what happened to a machine that is gone; None while it is there. Never raises."""

    def remove(self) -> None:
        """End all of it: processes, containers, network, volumes. May be called again; never raises."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *raised: object) -> None: ...


class Backend(Protocol):
    """Makes machines. One object serves all environments of a process, in any thread."""

    name: str

    def resources(self) -> Resources:
        """Return what there is of processors and memory; infinity where that is not known.

        Raises:
            EngineError: The engine does not answer.
        """

    def check(self, task: Task) -> None:
        """Raise when it cannot run a task at all.

        Raises:
            TaskError: The task asks for what it does not have; says what.
            EngineError: The engine is missing; says what to install or start.
        """

    def start(self, task: Task, limits: Limits, *, environment: Environment | None = None) -> Machine:
        """Build what is missing, and start a machine that nothing has touched, its healthchecks passed.

        ``environment`` takes the place of the task's, as one of a verifier's own.

        Raises:
            BuildError, EngineError, MachineLostError: It could not be started.
        """

    def close(self) -> None:
        """Remove every machine that this process has made. May be called again; never raises."""
