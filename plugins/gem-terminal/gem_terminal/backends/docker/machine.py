"""``DockerMachine``: the container of an episode, with the services that belong to it."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, Self

import docker.errors

from gem_terminal.backends.docker import files as moving
from gem_terminal.backends.docker import running
from gem_terminal.backends.docker.engine import FAILURES, Client, Engine, is_full
from gem_terminal.backends.docker.running import ContainerProgram, DockerTerminal, follow
from gem_terminal.backends.docker.starting import KEEPER
from gem_terminal.backends.docker.sweeping import Thing, remove
from gem_terminal.backends.interface import Completed, Process
from gem_terminal.errors import EngineError, MachineError, MachineLostError
from gem_terminal.kept_output import KeptOutput

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Resources

_ASK_S = 15.0
_TRIES = 3
_ROUNDS = 10
_MOST_LIST = 16_000_000
_KILLED_S = 3.0
_REMOVE_S = 30.0
_ROOM_PROCESSES, _ROOM_BYTES = 32, 64 * 2**20
_IN_WAY = ("not a directory", "is a directory", "file exists", "too many levels of symbolic links")


class DockerMachine:
    """A container of an episode, with all that belongs to it.

    Args:
        engine: The engine.
        name: Name of its container.
        things: All that is made for it, in the order in which it is removed.
        share: What its container may take.
        processes: Processes and threads at once.
        forget: Called with it once all of it is removed.
    """

    def __init__(
        self,
        engine: Engine,
        name: str,
        things: list[Thing],
        share: Resources,
        processes: int,
        forget: Callable[[DockerMachine], object],
    ) -> None:
        self.id = name
        self._share, self._processes, self._room = share, processes, 0
        self._engine = engine
        self._things = things
        self._forget = forget
        self._pid = os.getpid()
        self._lock = threading.Lock()
        self._removed = False
        self._lost: MachineLostError | None = None
        self._hang_ups: list[int] = []
        """Programs in terminals that were closed, which the engine does not tell them."""

    def open_terminal(
        self,
        command: Sequence[str],
        *,
        user: str = "",
        workdir: str = "",
        env: Mapping[str, str] | None = None,
        columns: int = 120,
        lines: int = 40,
    ) -> DockerTerminal:
        """Start a program in a pseudo-terminal, with the environment of the container and ``env``."""
        with self._asking("open a terminal") as client:
            program = self._start(client, command, user=user, workdir=workdir, env=env, tty=True)
            if program.pid is None:
                said = " ".join((program.read(0.0) or b"").decode("utf-8", "replace").split())[:300]
                program.close()
                raise self.why_lost() or MachineLostError(f"the program could not be started: {said}", by_agent=True)
            # Refused when the program has ended by now, which the next read says.
            with contextlib.suppress(*FAILURES):
                client.exec_resize(program.exec_id, height=lines, width=columns)
        return DockerTerminal(program, self.why_lost, self._hang_ups.append)

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
        """Run a command without a terminal and without input, and wait for it to end, or kill it."""
        output = KeptOutput(most_output)
        with self._asking("run a command") as client:
            try:
                program = self._start(client, command, user=user, workdir=workdir, env=env)
            except docker.errors.APIError as error:
                lost = self.why_lost()
                if lost is None and not isinstance(error, docker.errors.NotFound):
                    return Completed(126, str(error.explanation or error).encode())  # an unknown user or folder
                raise lost or error from error
            with contextlib.closing(program):
                code = follow(program, output, timeout_s)
                if code is None:
                    self._kill_all_of(program.pid or 0)
                    follow(program, output, _KILLED_S)
        if code is not None and code >= 126 and (lost := self.why_lost()) is not None:
            raise lost
        return Completed(code, bytes(output.head) + output.tail, output.dropped)

    def put(self, files: Mapping[str, Path | bytes | None], *, mode: int | None = None) -> None:
        """Write files, and folders with all that is in them, as root; what is there is replaced, folders whole."""
        with moving.put_archive(files, mode) as archive:
            self._unpack(archive)

    def get(self, path: str, *, most_bytes: int = 10_000_000) -> dict[str, bytes]:
        """Return the regular files at ``path``: a file, or a folder with all below it; a link is not followed."""
        with self._asking("get files out of a machine") as client:
            try:
                return moving.get_files(client, self.id, path, most_bytes)
            except docker.errors.NotFound:
                client.inspect_container(self.id)  # says whether it is the container that is not there
                return {}

    def save(self, path: str, file: BinaryIO, *, most_bytes: int) -> bool:
        """Write a tar archive of a file or folder; False when there is nothing at the path."""
        with self._asking("copy files out of a machine") as client:
            try:
                if moving.save_archive(client, self.id, path, file, most_bytes):
                    return True
            except docker.errors.NotFound:
                client.inspect_container(self.id)
                return False
        raise MachineLostError(f"{path} has more than {most_bytes / 2**20:.0f} MB to copy", by_agent=True)

    def load(self, path: str, file: BinaryIO) -> None:
        """Unpack an archive of ``save`` so that what it holds stands at a path; what is there is replaced."""
        with moving.load_archive(file, path) as archive:
            self._unpack(archive)

    def remove_files(self, paths: Sequence[str]) -> None:
        """Remove files and folders, following no links at their ends; what is not there is no error."""
        done = self.run(["rm", "-rf", "--", *paths], user="root", workdir="/", timeout_s=_REMOVE_S)
        if done.exit_code != 0:
            said = " ".join(done.output.decode("utf-8", "replace").split())[:300]
            raise MachineLostError(f"{', '.join(paths)} cannot be removed from the machine: {said}", by_agent=True)

    def processes(self) -> list[Process]:
        """Return all processes but those that keep the machine."""
        output, pid = self._ask(running.LIST)
        return running.read_list(output, pid)

    def kill(self, processes: Sequence[Process]) -> None:
        """Kill processes with SIGKILL; one that has ended, or whose number is another's by now, is left alone."""
        if processes:
            self._ask(running.kill_command(processes))

    def make_room(self) -> None:
        """Allow a few more processes each time, up to twice as many, and a little more memory."""
        self._room = min(self._room + _ROOM_PROCESSES, self._processes)
        memory = int(self._share.memory_mb) * 2**20 + _ROOM_BYTES
        said = {"PidsLimit": self._processes + self._room, "Memory": memory, "MemorySwap": memory}
        with contextlib.suppress(MachineError, *FAILURES):
            self._engine.client.ask("POST", f"/containers/{self.id}/update", json=said)

    def why_lost(self) -> MachineLostError | None:
        """Return what happened to a machine that is gone; None while it is there."""
        if self._lost is not None:
            return MachineLostError(str(self._lost), by_agent=self._lost.by_agent)
        if self._removed:
            return MachineLostError("the machine was removed", by_agent=False)
        try:
            with self._lock:
                found = self._engine.client.inspect_container(self.id)
        except docker.errors.NotFound:
            return MachineLostError("the machine's container was removed by someone else", by_agent=False)
        except (MachineError, *FAILURES) as error:
            return MachineLostError(f"the container engine does not answer: {error}", by_agent=False)
        state = found["State"]
        if state.get("Running"):
            return None
        if state.get("OOMKilled"):
            message = f"the machine used more memory than its {self._share.memory_mb:g} MB, and was ended"
            return MachineLostError(message, by_agent=True)
        if state.get("Error"):
            return MachineLostError(f"the machine's container failed: {state['Error']}", by_agent=None)
        began = " ".join([str(found.get("Path")), *map(str, found.get("Args") or ())])[:200]
        message = f"the machine's first process was ended (exit code {state.get('ExitCode')}; it began as {began!r})"
        # Ours cannot be killed from inside; the task's own mostly can, and who did it is not known.
        return MachineLostError(message, by_agent=found["Config"].get("Cmd") != list(KEEPER))

    def end(self, lost: MachineLostError) -> None:
        """End it at once because of what its agent did, which :meth:`why_lost` says from then on."""
        self._lost = lost
        with contextlib.suppress(MachineError, *FAILURES):
            self._engine.client.kill(self.id)

    def remove(self) -> None:
        """End all of it: processes, containers, network, volumes. May be called again; never raises.

        What the engine does not remove now is tried again when the process ends.
        """
        self._removed = True
        if os.getpid() != self._pid:
            return  # a child that was forked: all this is its parent's
        with self._lock:
            tried = list(self._things)
            left = remove(self._engine, tried)
            self._things[:] = left + [thing for thing in self._things if thing not in tried]
            if not self._things:
                self._forget(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.remove()

    @contextlib.contextmanager
    def _asking(self, what: str) -> Iterator[Client]:
        """Give the client; a failure is the machine's where that is gone, and else the engine's."""
        if self._removed or self._lost is not None:
            raise self.why_lost() or MachineLostError("the machine is gone")
        try:
            with self._engine.asking(what) as client:
                yield client
        except docker.errors.NotFound as error:
            raise self.why_lost() or EngineError(f"could not {what}: {error.explanation or error}") from error
        except EngineError as error:
            lost = self.why_lost()
            if lost is not None and lost.by_agent is not False:
                raise lost from error
            raise

    def _start(self, client: Client, command: Sequence[str], **how: Any) -> ContainerProgram:
        """Start a program.

        Raises:
            MachineLostError: It did not start; what holds it up is ended, and the machine with it.
        """
        before = ""
        if self._hang_ups:
            # Of a terminal that was closed: with the next program, since one of its own would take 80 ms.
            user = how.get("user") or client.inspect_container(self.id)["Config"].get("User", "")
            if user in ("", "root", "0", "0:0"):
                pids, self._hang_ups = self._hang_ups, []
                before = f"kill -HUP {' '.join(map(str, pids))} 2>/dev/null; "
            else:
                self._ask(["true"])
        try:
            return ContainerProgram(client, self.id, command, before=before, **how)
        except MachineLostError as lost:
            self.end(lost)
            raise

    def _ask(self, command: Sequence[str]) -> tuple[bytes, int]:
        """Run a command of the backend's own as root; return its output and number.

        Where the agent has used up the processes that there may be, the engine mostly fails to start another, or it
        takes long: then the container is started anew.
        """
        with self._asking("look after processes") as client:
            for _ in range(_TRIES):
                with contextlib.closing(self._start(client, command, user="root", workdir="/")) as program:
                    output = KeptOutput(_MOST_LIST)
                    code = follow(program, output, _ASK_S)
                if program.pid is not None and code is not None:
                    return bytes(output.head) + output.tail, program.pid
                if code is None:
                    break
        self._restart()
        return b"", 0

    def _restart(self) -> None:
        """End all that runs in it; its files stay.

        Raises:
            MachineLostError: It does not start again, as where the agent has removed its shell.
        """
        with self._asking("restart a machine") as client, self._lock:
            try:
                client.restart(self.id, timeout=0)
            except docker.errors.APIError as error:
                message = f"the machine does not start again: {error.explanation}"
                self._lost = MachineLostError(message, by_agent=True)
                raise MachineLostError(message, by_agent=True) from error

    def _kill_all_of(self, pid: int) -> None:
        """Kill a command with all that it has started, again and again while there is more."""
        processes = self.processes()
        started = next((process.started for process in processes if process.pid == pid), None)
        if started is None:
            return
        for _ in range(_ROUNDS):
            found = running.came_from(processes, pid, started)
            if not found:
                return
            self.kill(found)
            processes = self.processes()
        self._restart()

    def _unpack(self, archive: IO[bytes]) -> None:
        with self._asking("put files into a machine") as client:
            try:
                client.put_archive(self.id, "/", archive)
            except docker.errors.APIError as error:
                if is_full(error):
                    raise MachineLostError(f"the machine's disk is full: {error.explanation}", by_agent=True) from error
                if any(words in str(error) for words in _IN_WAY):
                    message = f"files cannot be put into the machine: {error.explanation}"
                    raise MachineLostError(message, by_agent=True) from error
                raise
