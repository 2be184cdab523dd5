"""A machine for tests that is this one: real processes and pseudo-terminals, and no isolation at all."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import secrets
import select
import shutil
import signal
import struct
import subprocess
import termios
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from gem_terminal.backends.interface import Completed, Process
from gem_terminal.errors import MachineLostError

_MARKER = "GEM_HOST_MACHINE"


class HostTerminal:
    """A program in a pseudo-terminal of this machine."""

    def __init__(self, process: subprocess.Popen[bytes], master: int) -> None:
        self._process, self._master, self.pid = process, master, process.pid

    def read(self, timeout_s: float) -> bytes:
        end = time.monotonic() + timeout_s
        while self._master >= 0:
            if select.select([self._master], [], [], max(0.0, min(end - time.monotonic(), 0.1)))[0]:
                with contextlib.suppress(OSError):
                    if data := os.read(self._master, 65_536):
                        return data
                break
            if self._process.poll() is not None:
                break
            if time.monotonic() >= end:
                return b""
        raise MachineLostError("the program has ended")

    def write(self, data: bytes) -> None:
        end = time.monotonic() + 3
        while data and time.monotonic() < end:
            if self._master < 0 or self._process.poll() is not None:
                raise MachineLostError("the program has ended")
            if select.select([], [self._master], [], 0.1)[1]:
                with contextlib.suppress(BlockingIOError):
                    data = data[os.write(self._master, data) :]

    def close(self) -> None:
        if self._master >= 0:
            os.close(self._master)
            self._master = -1
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(2)


class HostMachine:
    """This machine, with a home folder below a temporary one; its processes are known by a variable."""

    def __init__(self, folder: Path, *, path: str | None = None) -> None:
        self.id = f"host-{secrets.token_hex(6)}"
        self.has_bash = path is None
        self._terminals: list[HostTerminal] = []
        path = path or "/usr/local/bin:/usr/bin:/bin"
        self._place: dict[str, Any] = {"cwd": folder, "env": {"PATH": path, "HOME": str(folder), _MARKER: self.id}}

    def open_terminal(
        self, command: Sequence[str], *, workdir: str = "", env: Any = None, columns: int, lines: int, **_: Any
    ) -> HostTerminal:
        master, slave = pty.openpty()
        fcntl.ioctl(master, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        os.set_blocking(master, False)
        place = {"cwd": workdir or self._place["cwd"], "env": self._place["env"] | (env or {})}
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), slave)
        take = {"start_new_session": True, "preexec_fn": lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0)}
        self._terminals.append(HostTerminal(subprocess.Popen(list(command), **streams, **place, **take), master))
        os.close(slave)
        return self._terminals[-1]

    def run(self, command: Sequence[str], *, timeout_s: float, most_output: int = 1_000_000, **_: Any) -> Completed:
        streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        done = subprocess.run(list(command), **streams, **self._place, timeout=timeout_s, check=False)
        return Completed(done.returncode, done.stdout[:most_output])

    def put(self, files: Mapping[str, bytes], **_: Any) -> None:
        for path, content in files.items():
            Path(path).write_bytes(content)

    def remove_files(self, paths: Sequence[str]) -> None:
        for path in paths:
            shutil.rmtree(path, ignore_errors=True)

    def processes(self) -> list[Process]:
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if f"{_MARKER}={self.id}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                    fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
                    command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                    found.append(Process(int(folder.name), int(fields[1]), int(fields[19]), command, int(fields[3])))
        return found

    def kill(self, processes: Sequence[Process]) -> None:
        there = {(process.pid, process.started) for process in self.processes()}
        for process in processes:
            if (process.pid, process.started) in there:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process.pid, signal.SIGKILL)

    def make_room(self) -> None:
        """Have no limits."""

    def why_lost(self) -> MachineLostError | None:
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for terminal in self._terminals:
            terminal.close()
        end = time.monotonic() + 10
        while (left := self.processes()) and time.monotonic() < end:
            self.kill(left)
