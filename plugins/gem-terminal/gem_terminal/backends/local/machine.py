"""``LocalMachine``: a sandbox over a folder, as the rest of this package sees a machine."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import tarfile
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import IO, BinaryIO, Self

from gem_terminal.backends.interface import Completed, Process
from gem_terminal.backends.local.launch import Sandbox, number_inside, ready, start_program
from gem_terminal.backends.local.terminal import LocalTerminal, open_pair
from gem_terminal.errors import EngineError, MachineLostError, TaskError
from gem_terminal.kept_output import KeptOutput

ROOT_USERS = ("", "root", "0", "root:root", "0:0", "0:root", "root:0")
_READ_ONLY = ("bin", "sbin", "lib", "lib32", "lib64", "libx32", "usr", "proc", "sys", "dev")
_FILES_S = 150.0
"""Seconds that reading or writing files may take."""

_NOTHING = 44
_KILLING_S = 10.0
_DYING_S = 0.3

_ENV = {"PATH": "/usr/bin:/bin", "LC_ALL": "C"}
# What is there goes first, so that folders are replaced whole. Links on the way are replaced by tar, which has the
# folders above as members.
_PUT = 'rm -rf -- "$@" 2>/dev/null; exec tar -xpf - -C / --no-same-owner --no-overwrite-dir'
_GET = """
[ ! -L "$1" ] || exit 0
if [ -d "$1" ]; then cd -- "$1" && set -- . "$2"; elif [ ! -f "$1" ]; then exit 0; fi
find "$1" -type f -size "-$2c" -print0 | sort -z | exec tar -cPf - --null --no-recursion -T -
"""
_SAVE = f"""
path=$(readlink -e -- "$1") || exit {_NOTHING}
exec tar -cpf - --numeric-owner -C "${{path%/*}}/" -- "./${{path##*/}}"
"""
_LOAD = """
set -e
mkdir -p -- "${1%/*}/"
new=$(mktemp -d "${1%/*}/.gem-XXXXXX")
tar -xpf - -C "$new" --numeric-owner
rm -rf -- "$1"
mv -T -- "$new/$(ls -A "$new")" "$1"
rmdir -- "$new"
"""


class LocalMachine:
    """A sandbox over a folder; see ``Machine``. Its methods may be called from several threads.

    Args:
        id: Names it in messages.
        sandbox: The sandbox.
        env: Environment variables of its programs.
        workdir: Their working directory.
        limits: Their limits, as options of ``prlimit``.
        release: Called at its end.
    """

    def __init__(
        self,
        id: str,
        sandbox: Sandbox,
        *,
        env: Mapping[str, str],
        workdir: str,
        limits: Sequence[str],
        release: Callable[[], object],
    ) -> None:
        self.id = id
        self._sandbox, self._env, self._workdir, self._limits = sandbox, env, workdir, limits
        self._release = release
        self._removed = False
        self._programs: list[subprocess.Popen[bytes]] = []

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
        """Start a program in a pseudo-terminal."""
        self._check_there()
        controlling, program = open_pair(self._sandbox.terminals, columns, lines)
        try:
            with open(program, "r+b", buffering=0) as streams:
                process = self._start(command, user, workdir, {"TERM": "xterm", **(env or {})}, streams, "--ctty")
        except BaseException:
            os.close(controlling)
            raise
        self._programs = [one for one in self._programs if one.poll() is None] + [process]
        return LocalTerminal(process, controlling, self.why_lost)

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
        """Run a command without a terminal and without input, and wait for it to end."""
        before = {(process.pid, process.started) for process in self.processes()}
        kept = KeptOutput(most_output)
        output, output_in = os.pipe2(os.O_CLOEXEC)
        with open(output, "rb", buffering=0) as reader:
            with open(output_in, "wb", buffering=0) as writer:
                process = self._start(command, user, workdir, env or {}, writer)
            in_time = _follow(process, reader, timeout_s, kept)
            if not in_time:
                self._kill_all_of(process, before)
                process.wait()
                kept.add(os.read(output, 65_536) if ready(0, output) else b"")
        code = process.returncode
        if code:
            if code == -signal.SIGKILL or kept.head.startswith(b"nsenter: "):
                self._sandbox.has_ended(_DYING_S)  # its programs end a moment before its first process is gone
            self._check_there()
        exit_code = (code if code >= 0 else 128 - code) if in_time else None
        return Completed(exit_code, bytes(kept.head) + kept.tail, kept.dropped)

    def start_main(self, command: Sequence[str]) -> None:
        """Start what a container would have as its first program; its output is thrown away."""
        with open(os.devnull, "r+b") as nowhere:
            self._programs.append(self._start(command, "", "", {}, nowhere))

    def put(self, files: Mapping[str, Path | bytes | None], *, mode: int | None = None) -> None:
        """Write files, and folders with all that is in them, as root; what is there is replaced, folders whole."""
        with tempfile.TemporaryFile() as archive:
            with tarfile.open(fileobj=archive, mode="w") as tar:
                for path, source in files.items():
                    _check_path(path)
                    _add(tar, path.strip("/"), source, mode)
            archive.seek(0)
            self._pipe(_PUT, list(files), archive)

    def get(self, path: str, *, most_bytes: int = 10_000_000) -> dict[str, bytes]:
        """Return the regular files at ``path``: a file, or a folder with all below it."""
        found: dict[str, bytes] = {}
        left = most_bytes
        with tempfile.TemporaryFile() as archive, contextlib.suppress(tarfile.TarError):
            most_mb = 2 * most_bytes + (16 << 20)  # of many small files, also their names
            self._pipe(_GET, [path, str(most_bytes + 1)], None, archive, most_mb)
            archive.seek(0)
            with tarfile.open(fileobj=archive, mode="r:") as tar:
                for member in tar:
                    name = "" if member.name.startswith("/") else member.name.removeprefix("./")
                    if member.isreg() and member.size <= left and (file := tar.extractfile(member)):
                        found[name] = file.read()
                        left -= member.size
        return found

    def remove_files(self, paths: Sequence[str]) -> None:
        """Remove files and folders; what is not there is no error."""
        for path in paths:
            _check_path(path)
        self._pipe('rm -rf -- "$@"; :', paths, None)

    def save(self, path: str, file: BinaryIO, *, most_bytes: int) -> bool:
        """Write a tar archive of a file or folder; see ``Machine.save``."""
        with tempfile.TemporaryFile() as archive:
            code = self._pipe(_SAVE, [path], None, archive, most_bytes)
            if code == _NOTHING:
                return False
            if code:
                message = f"{path} in {self.id} has more than {most_bytes} bytes to take along, or cannot be read"
                raise MachineLostError(message, by_agent=True)
            archive.seek(0)
            shutil.copyfileobj(archive, file)
        return True

    def load(self, path: str, file: BinaryIO) -> None:
        """Unpack an archive of ``save`` so that what it holds stands at a path; what is there is replaced."""
        _check_path(path)
        with tempfile.TemporaryFile() as archive:
            shutil.copyfileobj(file, archive)
            archive.seek(0)
            self._pipe(_LOAD, ["/" + path.strip("/")], archive)

    def processes(self) -> list[Process]:
        """Return all processes but the one that keeps the machine."""
        self._check_there()
        return self._sandbox.processes()

    def kill(self, processes: Sequence[Process]) -> None:
        """Kill processes with SIGKILL; one that has ended, or whose number is another's by now, is left alone."""
        self._check_there()
        self._sandbox.kill(processes)

    def make_room(self) -> None:
        """Do nothing: its limits are those of each process."""

    def why_lost(self) -> MachineLostError | None:
        """Return what happened to a machine that is gone; None while it is there."""
        if self._removed:
            return MachineLostError(f"{self.id} was removed", by_agent=False)
        if self._sandbox.has_ended():
            return MachineLostError(f"{self.id}: the machine is gone, its first process was ended", by_agent=True)
        return None

    def remove(self) -> None:
        """End all of it. May be called again; never raises."""
        if not self._removed:
            self._removed = True
            self._sandbox.end()
            for program in self._programs:
                program.kill()
                program.wait()
            self._release()

    def __enter__(self) -> Self:
        """Return it."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove it."""
        self.remove()

    def _check_there(self) -> None:
        lost = self.why_lost()
        if lost is not None:
            raise lost

    def _start(
        self,
        command: Sequence[str],
        user: str,
        workdir: str,
        env: Mapping[str, str],
        streams: IO[bytes],
        *options: str,
    ) -> subprocess.Popen[bytes]:
        """Start a program with both its outputs, and in a terminal its input too, in one place."""
        if user not in ROOT_USERS:
            raise TaskError(f"the task runs a program as the user {user!r}; a sandbox has root alone: use 'docker'")
        self._check_there()
        words = self._sandbox.words(command, {**self._env, **env}, workdir or self._workdir, self._limits, *options)
        try:
            return start_program(
                words, stdin=streams if options else subprocess.DEVNULL, stdout=streams, stderr=streams
            )
        except (OSError, ValueError) as error:
            raise EngineError(f"{self.id}: {command[0]!r} cannot be started: {error}") from error

    def _kill_all_of(self, process: subprocess.Popen[bytes], before: set[tuple[int, int]] | None = None) -> None:
        """Kill a command, all below it, and orphans that were not there before (if given), until there are none."""
        top = number_inside(process)
        deadline = time.monotonic() + _KILLING_S
        while time.monotonic() < deadline and (found := _came_from(self.processes(), top, before)):
            self._sandbox.kill(found)
        process.kill()  # nsenter stops itself when its program is stopped

    def _pipe(
        self,
        script: str,
        arguments: Sequence[str],
        stdin: IO[bytes] | None,
        stdout: IO[bytes] | None = None,
        most_bytes: int | None = None,
    ) -> int:
        """Run a script of ours that reads an archive, or writes one; return its exit code.

        Raises:
            MachineLostError: It failed while it read one, or the machine is gone.
        """
        self._check_there()
        limits = [] if most_bytes is None else [f"--fsize={most_bytes}"]
        words = self._sandbox.words(["sh", "-c", script, "sh", *arguments], _ENV, "/", limits)
        nothing = subprocess.DEVNULL
        process = start_program(words, stdin=stdin or nothing, stdout=stdout or nothing, stderr=subprocess.PIPE)
        try:
            said = process.communicate(timeout=_FILES_S)[1]
        except subprocess.TimeoutExpired:
            self._kill_all_of(process)
            said = process.communicate()[1] + b"it took too long"
        if process.returncode:
            self._check_there()
            if stdout is None:
                words_said = " ".join(said.decode("utf-8", "replace").split())[-300:]
                full = b"No space left" in said or b"quota" in said
                raise MachineLostError(f"{self.id}: no files can be written: {words_said}", by_agent=full or None)
        return process.returncode


def _follow(process: subprocess.Popen[bytes], reader: IO[bytes], timeout_s: float, kept: KeptOutput) -> bool:
    """Read what a command writes until it has ended; tell whether it has, in time.

    What goes on in the background, and holds its output open, is not waited for.
    """
    deadline = time.monotonic() + timeout_s
    output, ended = reader.fileno(), os.pidfd_open(process.pid)
    watched = [ended, output]
    try:
        while (left := deadline - time.monotonic()) > 0 and (found := ready(left, *watched)):
            # Once it has ended, all that it wrote is in the pipe, and what a pipe holds is read at once.
            data = os.read(output, 65_536) if output in (found | ready(0, output)) else b""
            kept.add(data)
            if ended in found:
                process.wait()
                return True
            if not data:
                watched = [ended]
        return False
    finally:
        os.close(ended)


def _came_from(processes: Sequence[Process], top: int, before: set[tuple[int, int]] | None) -> list[Process]:
    by_number = {process.pid: process for process in processes}

    def is_of_it(process: Process) -> bool:
        while process.pid != top and process.parent in by_number:
            process = by_number[process.parent]
        is_orphan = process.parent != 0 and before is not None and (process.pid, process.started) not in before
        return process.pid == top or is_orphan

    return [process for process in processes if is_of_it(process)]


def _check_path(path: str) -> None:
    parts = [part for part in path.split("/") if part not in ("", ".")]
    if not path.startswith("/") or ".." in parts or "\0" in path or not parts:
        raise EngineError(f"{path!r} is not an absolute path without '..'")
    if parts[0] in _READ_ONLY:
        raise EngineError(f"{path} is the host's, and read-only in a sandbox: use the backend 'docker'")


def _add(tar: tarfile.TarFile, name: str, source: Path | bytes | None, mode: int | None) -> None:
    """Add a file or folder to an archive, and the folders above it."""

    def owned(entry: tarfile.TarInfo) -> tarfile.TarInfo | None:
        if not (entry.isreg() or entry.isdir() or entry.issym()):
            return None
        entry.uid = entry.gid = 0
        entry.uname = entry.gname = ""
        if entry.isreg():
            entry.mode = (entry.mode & 0o777) | 0o444 if mode is None else mode
        elif entry.isdir():
            entry.mode = 0o755
        return entry

    for folder in reversed(Path(name).parents[:-1]):
        above = tarfile.TarInfo(str(folder))
        above.type, above.mode = tarfile.DIRTYPE, 0o755
        tar.addfile(above)
    if source is None:
        entry = tarfile.TarInfo(name)
        entry.type, entry.mode = tarfile.DIRTYPE, 0o777
        tar.addfile(entry)
    elif isinstance(source, bytes):
        entry = tarfile.TarInfo(name)
        entry.size, entry.mode = len(source), 0o644 if mode is None else mode
        tar.addfile(entry, BytesIO(source))
    else:
        tar.add(source.resolve(), name, filter=owned)
