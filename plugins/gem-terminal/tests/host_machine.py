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
from types import TracebackType
from typing import Self

from gem_terminal.backends.interface import Completed, Process
from gem_terminal.errors import MachineLostError

_MARKER = "GEM_HOST_MACHINE"


class HostTerminal:
    """A program in a pseudo-terminal of this machine."""

    def __init__(self, process: subprocess.Popen[bytes], master: int) -> None:
        self._process = process
        self._master = master
        self.pid = process.pid

    def read(self, timeout_s: float) -> bytes:
        end = time.monotonic() + timeout_s
        while True:
            if self._master < 0:
                raise MachineLostError("the terminal is closed")
            wait = max(0.0, min(end - time.monotonic(), 0.1))
            if select.select([self._master], [], [], wait)[0]:
                with contextlib.suppress(OSError):
                    data = os.read(self._master, 65_536)
                    if data:
                        return data
                self._process.wait(5)
                raise MachineLostError("the program has ended")
            if self._process.poll() is not None and not select.select([self._master], [], [], 0)[0]:
                raise MachineLostError("the program has ended")
            if time.monotonic() >= end:
                return b""

    def write(self, data: bytes) -> None:
        end = time.monotonic() + 3
        while data:
            if self._master < 0 or self._process.poll() is not None:
                raise MachineLostError("the program has ended")
            left = end - time.monotonic()
            if left <= 0:
                return
            if select.select([], [self._master], [], min(left, 0.1))[1]:
                try:
                    data = data[os.write(self._master, data) :]
                except BlockingIOError:
                    continue
                except OSError as error:
                    raise MachineLostError("the program has ended") from error

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
        self.folder = folder
        self.has_bash = path is None
        self._path = path
        self._terminals: list[HostTerminal] = []

    def _environment(self, env: Mapping[str, str] | None) -> dict[str, str]:
        kept = {"PATH": self._path or "/usr/local/bin:/usr/bin:/bin", "HOME": str(self.folder), _MARKER: self.id}
        return {**kept, **(env or {})}

    def open_terminal(
        self,
        command: Sequence[str],
        *,
        user: str = "",
        workdir: str = "",
        env: Mapping[str, str] | None = None,
        columns: int = 120,
        lines: int = 40,
    ) -> HostTerminal:
        master, slave = pty.openpty()
        fcntl.ioctl(master, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        os.set_blocking(master, False)
        process = subprocess.Popen(
            list(command),
            stdin=slave,
            stdout=slave,
            stderr=slave,
            cwd=workdir or self.folder,
            env=self._environment(env),
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        os.close(slave)
        terminal = HostTerminal(process, master)
        self._terminals.append(terminal)
        return terminal

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
        done = subprocess.run(
            list(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=workdir or self.folder,
            env=self._environment(env),
            timeout=timeout_s,
            check=False,
        )
        return Completed(done.returncode, done.stdout[:most_output])

    def put(self, files: Mapping[str, Path | bytes], *, mode: int | None = None) -> None:
        for path, content in files.items():
            Path(path).write_bytes(content if isinstance(content, bytes) else content.read_bytes())

    def get(self, path: str, *, most_bytes: int = 10_000_000) -> dict[str, bytes]:
        return {"": Path(path).read_bytes()}

    def remove_files(self, paths: Sequence[str]) -> None:
        for path in paths:
            shutil.rmtree(path, ignore_errors=True)

    def processes(self) -> list[Process]:
        found = []
        marker = f"{_MARKER}={self.id}".encode()
        for entry in os.listdir("/proc"):
            if not entry.isdigit():
                continue
            try:
                if marker not in Path(f"/proc/{entry}/environ").read_bytes().split(b"\0"):
                    continue
                fields = Path(f"/proc/{entry}/stat").read_text(errors="replace").rpartition(")")[2].split()
                command = Path(f"/proc/{entry}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue
            found.append(Process(int(entry), int(fields[1]), int(fields[19]), command[:200].strip(), int(fields[3])))
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

    def remove(self) -> None:
        for terminal in self._terminals:
            terminal.close()
        end = time.monotonic() + 10
        while (left := self.processes()) and time.monotonic() < end:
            self.kill(left)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.remove()
