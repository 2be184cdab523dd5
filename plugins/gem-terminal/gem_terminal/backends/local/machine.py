"""``LocalMachine``: a sandbox, as the rest of this package sees a machine."""

from __future__ import annotations

import os
import select
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from gem_terminal.backends.interface import Change, Completed, Process
from gem_terminal.backends.local.terminal import LocalTerminal, Middle, drain, follow
from gem_terminal.errors import EngineError, MachineLostError, TaskError

if TYPE_CHECKING:
    from gem_terminal.backends.local.channel import Channel
    from gem_terminal.tasks.task import Network

_ROOT = ("", "root", "0", "root:root", "0:0", "0:root", "root:0")
_OFFLINE = ("none",)
_SYSTEM = ("bin", "sbin", "lib", "lib32", "lib64", "libx32", "usr", "proc", "sys", "dev", "python", "nix", "gnu")
_BATCH = 32
_JUDGE_S = 150.0
_LONG_S = 120.0


@dataclass(frozen=True)
class Surroundings:
    """What programs of a machine find.

    Args:
        env: Environment variables.
        workdir: Working directory.
    """

    env: Mapping[str, str] = field(default_factory=dict)
    workdir: str = "/"


class LocalMachine:
    """One view of a sandbox: the agent's, or a judge's. Its methods may be called from several threads.

    Args:
        id: Names it in messages.
        channel: To its keeper.
        surroundings: What its programs find.
        release: Ends the sandbox, or the judge's part of it.
        view: Which view it is.
    """

    can_hide = False  # the keeper is not dumpable, and the first process of all

    def __init__(
        self, id: str, channel: Channel, surroundings: Surroundings, release: Callable[[], None], view: str = "root"
    ) -> None:
        self.id = id
        self._channel, self._surroundings, self._view = channel, surroundings, view
        self._release = release
        self._removed = False
        self._judges = count(1)

    def open_terminal(
        self,
        command: Sequence[str],
        *,
        user: str = "",
        workdir: str = "",
        env: Mapping[str, str] | None = None,
        columns: int = 120,
        lines: int = 40,
    ) -> LocalTerminal:
        """Start a program in a pseudo-terminal, with the environment of the machine and ``env``.

        Raises:
            MachineLostError: The machine is gone, or the program is not there.
            EngineError: The machine cannot open a terminal.
            TaskError: It should run as another user than root.
        """
        job = self._job(command, user, workdir, {"TERM": "xterm", **self._surroundings.env, **(env or {})})
        try:
            answer, descriptors = self._ask("terminal", **job, terminal=True, columns=columns, lines=lines)
        except EngineError as error:
            if "gem: cannot run" in str(error):
                raise MachineLostError(str(error), by_agent=None) from error
            raise
        controlling, ended = descriptors
        return LocalTerminal(answer["pid"], controlling, ended, self.why_lost)

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

        When ``timeout_s`` has passed it is killed, with all processes that have come from it.

        Raises:
            MachineLostError: The machine is gone.
            EngineError: The machine cannot start it.
            TaskError: It should run as another user than root.
        """
        kept = Middle(most_output)
        code = self.follow(command, kept.add, user=user, workdir=workdir, env=env, timeout_s=timeout_s)
        return Completed(code, kept.whole(), kept.dropped)

    def follow(
        self,
        command: Sequence[str],
        take: Callable[[bytes], None],
        *,
        user: str = "",
        workdir: str = "",
        env: Mapping[str, str] | None = None,
        timeout_s: float,
    ) -> int | None:
        """Run a command as ``run`` does, and pass its output on as it comes; return its exit code."""
        deadline = time.monotonic() + timeout_s
        job = self._job(command, user, workdir, {**self._surroundings.env, **(env or {})})
        (output, output_in), (done, done_in) = os.pipe2(os.O_CLOEXEC), os.pipe2(os.O_CLOEXEC)
        os.set_blocking(output, False)
        try:
            try:
                answer, _ = self._ask("run", (output_in, done_in), **job, terminal=False)
            finally:
                os.close(output_in)
                os.close(done_in)
            code = follow(output, done, deadline, take)
            if code is None:
                self._ask("end", run=answer["number"])
                drain(output, take)
            elif code == 137:
                self._check_there()
            return code
        finally:
            os.close(output)
            os.close(done)

    def put(self, files: Mapping[str, Path | bytes], *, mode: int | None = None) -> None:
        """Write files, and folders with all that is in them, as root; what is there is replaced, folders whole.

        A link at a path, or on the way to it, is replaced by what it should be.

        Raises:
            MachineLostError: The machine is gone, or its file system is full.
            EngineError: A path is the host's, which a machine may not change.
        """
        for path in files:
            self._check_path(path)
        self._write(entry for path, source in files.items() for entry in _entries(path, source, mode, "fresh"))

    def merge(self, files: Mapping[str, Path | bytes], kept: Callable[[Path], bool]) -> None:
        """Write as ``put`` does, but into the folders that are there, and only files that are to be kept."""

        def checked() -> Iterator[tuple[dict[str, Any], Path | bytes | None]]:
            for path, source in files.items():
                for entry in _entries(path, source, None, "folder", kept):
                    self._check_path(entry[0]["path"], top=True)
                    yield entry

        self._write(checked())

    def make_folder(self, path: str) -> None:
        """Make a folder where there is none."""
        self._check_path(path, top=True)
        self._ask("write", entries=[{"path": path, "kind": "folder", "mode": None}])

    def get(self, path: str, *, most_bytes: int = 10_000_000) -> dict[str, bytes]:
        """Return the regular files at ``path``: a file, or a folder with all below it.

        Raises:
            MachineLostError: The machine is gone.
        """
        answer, (memory,) = self._ask("read", path=path, most_bytes=most_bytes, timeout_s=_LONG_S)
        with open(memory, "rb") as file:
            file.seek(0)
            return {name: file.read(size) for name, size in answer["index"]}

    def remove_files(self, paths: Sequence[str]) -> None:
        """Remove files and folders, following no links; what is not there is no error."""
        for path in paths:
            self._check_path(path)
        self._ask("remove", paths=list(paths))

    def changed(self) -> Mapping[str, Change] | None:
        """Return the absolute paths that are not what the template has, with how they differ.

        The host's programs, which cannot differ, are not among them.

        Raises:
            MachineLostError: The machine is gone, or has too many files to tell.
        """
        answer, _ = self._ask("changed", timeout_s=_JUDGE_S)
        found: Mapping[str, Change] | None = answer["changed"]
        return found

    def put_back(self, paths: Sequence[str]) -> list[str]:
        """Make paths what the template has there; what it has not is removed. No program of the machine is used.

        Returns:
            The paths that did differ, in order.

        Raises:
            MachineLostError: The machine is gone, or its file system is full.
        """
        answer, _ = self._ask("put_back", paths=list(paths), timeout_s=_JUDGE_S)
        return [str(path) for path in answer["paths"]]

    def processes(self) -> list[Process]:
        """Return all processes of this view but those that keep the machine."""
        answer, _ = self._ask("processes")
        return [Process(*row) for row in answer["processes"]]

    def kill(self, processes: Sequence[Process]) -> None:
        """Kill processes with SIGKILL; one that has ended, or whose number is another's by now, is left alone."""
        self._ask("kill", processes=[[process.pid, process.started] for process in processes])

    def judge(
        self,
        network: Network | None = None,
        *,
        user: str = "",
        prepare: Callable[[LocalMachine], object] | None = None,
    ) -> LocalMachine:
        """Return a machine with a copy of this one's files, whose files and memory this one's processes cannot reach.

        It shares this one's loopback and its process numbers, and ends with it.

        Args:
            network: None, or ``"none"``.
            user: Of no account: all run as the sandbox's root.
            prepare: Called with the other before any program runs in it.

        Raises:
            MachineLostError: The machine is gone, or the copy cannot be made.
            TaskError: It should have a network.
        """
        del user
        if network not in (None, *_OFFLINE):
            raise TaskError(f"the verifier asks for the network {network!r}, which a sandbox lacks: use 'docker'")
        name = f"judges/{next(self._judges)}"
        self._channel.ask("judge", name=name, timeout_s=_JUDGE_S)

        def release() -> None:
            self._channel.ask("dismiss", view=name)

        judge = LocalMachine(f"{self.id}-{name.replace('/', '-')}", self._channel, self._surroundings, release, name)
        if prepare is not None:
            try:
                prepare(judge)
            except BaseException:
                judge.remove()
                raise
        return judge

    def written_mb(self) -> float | None:
        """Return how many megabytes the agent's files have grown by."""
        answer, _ = self._channel.ask("sizes", timeout_s=_JUDGE_S)
        return float(answer["grown_kb"]) / 1024

    def why_lost(self) -> MachineLostError | None:
        """Return what happened to a machine that is gone; None while it is there."""
        if self._removed:
            return MachineLostError(f"{self.id} was removed", by_agent=False)
        return self._channel.why_lost()

    def remove(self) -> None:
        """End all of it. May be called again; never raises."""
        if not self._removed:
            self._removed = True
            try:
                self._release()
            except (MachineLostError, EngineError):
                return  # what a judge had has gone with its machine

    def __enter__(self) -> Self:
        """Return it."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Remove it."""
        self.remove()

    def start_main(self, command: Sequence[str]) -> None:
        """Start the program that a container would have as its first, with its output thrown away."""
        nowhere = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)
        try:
            self._ask("main", (nowhere,), **self._job(command, "", "", self._surroundings.env), terminal=False)
        finally:
            os.close(nowhere)

    def _job(self, command: Sequence[str], user: str, workdir: str, env: Mapping[str, str]) -> dict[str, Any]:
        if user not in _ROOT:
            raise TaskError(f"the task runs a program as the user {user!r}; a sandbox has root alone: use 'docker'")
        if not command:
            raise TaskError("a command has at least one word")
        return {"words": list(command), "workdir": workdir or self._surroundings.workdir, "env": dict(env)}

    def _ask(self, op: str, descriptors: tuple[int, ...] = (), **words: Any) -> tuple[dict[str, Any], list[int]]:
        self._check_there()
        return self._channel.ask(op, descriptors, view=self._view, **words)

    def _check_there(self) -> None:
        lost = self.why_lost()
        if lost is not None:
            raise lost

    def _check_path(self, path: str, *, top: bool = False) -> None:
        parts = [part for part in path.split("/") if part not in ("", ".")]
        if not path.startswith("/") or ".." in parts or "\0" in path or not (parts or top):
            raise EngineError(f"{path!r} is not an absolute path without '..'")
        if parts and parts[0] in _SYSTEM and parts[:2] != ["usr", "local"]:
            raise EngineError(f"{path} is the host's, and read-only in a sandbox: use the backend 'docker'")

    def _write(self, entries: Iterable[tuple[dict[str, Any], Path | bytes | None]]) -> None:
        batch: list[dict[str, Any]] = []
        opened: list[int] = []
        try:
            for entry, source in entries:
                if source is not None:
                    opened.append(_opened(source))
                batch.append(entry)
                if len(opened) == _BATCH or len(batch) == 1000:
                    self._send(batch, opened)
            self._send(batch, opened)
        finally:
            for descriptor in opened:
                os.close(descriptor)

    def _send(self, batch: list[dict[str, Any]], opened: list[int]) -> None:
        if batch:
            self._ask("write", tuple(opened), entries=batch, timeout_s=_LONG_S)
        for descriptor in opened:
            os.close(descriptor)
        batch.clear()
        opened.clear()


def _opened(source: Path | bytes) -> int:
    """Return a file descriptor of contents."""
    if isinstance(source, Path):
        return os.open(source, os.O_RDONLY | os.O_CLOEXEC)
    memory = os.memfd_create("gem", os.MFD_CLOEXEC)
    with open(memory, "wb", closefd=False) as file:
        file.write(source)
    return memory


def _entries(
    path: str, source: Path | bytes, mode: int | None, folders: str, kept: Callable[[Path], bool] | None = None
) -> Iterator[tuple[dict[str, Any], Path | bytes | None]]:
    """Yield what a keeper is told to write, and where the contents come from."""
    if isinstance(source, bytes):
        yield {"path": path, "kind": "file", "mode": 0o644 if mode is None else mode}, source
    elif not source.is_dir():
        yield _file(path, source, mode), source
    else:
        yield {"path": path, "kind": folders, "mode": 0o755 if folders == "fresh" else None}, None
        for found in sorted(source.iterdir()):
            if kept is not None and not kept(found):
                continue
            inner = f"{path.rstrip('/')}/{found.name}"
            if found.is_symlink():
                yield {"path": inner, "kind": "link", "target": os.readlink(found)}, None
            elif found.is_dir() or found.is_file():
                yield from _entries(inner, found, mode, "folder", kept)


def _file(path: str, source: Path, mode: int | None) -> dict[str, Any]:
    permissions = (source.stat().st_mode & 0o777) | 0o444 if mode is None else mode
    return {"path": path, "kind": "file", "mode": permissions}


def end_process(process: subprocess.Popen[bytes]) -> None:
    """Wait for a sandbox to end, and kill it where it does not."""
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    finally:
        if process.stderr is not None:
            process.stderr.close()


def wait_for(process: subprocess.Popen[bytes], channel: Channel, timeout_s: float) -> bool:
    """Wait until a keeper is ready; False where it is not, or has ended."""
    deadline = time.monotonic() + timeout_s
    watched = os.pidfd_open(process.pid)
    try:
        poller = select.poll()
        poller.register(watched, select.POLLIN)
        while not channel.ready.wait(0.05):
            if poller.poll(0) or time.monotonic() > deadline:
                return False
        return channel.why_lost() is None
    finally:
        os.close(watched)
