"""A command in a terminal of its own, for tests of what a person sees and types."""

from __future__ import annotations

import codecs
import os
import pty
import select
import subprocess
import sys
from functools import partial
from pathlib import Path

from command_calls import PROGRAM

DEADLINE_S = 60
"""Far more than is ever needed: what is waited for is text, not time."""


class InTerminal:
    """The command in a terminal of its own."""

    def __init__(self, arguments: list[str], cwd: Path, code: str = "", **env: str) -> None:
        self._leader, follower = pty.openpty()
        inherited = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"{code}\n{PROGRAM}", *arguments],
            cwd=cwd,
            env={**inherited, "PYTHONPATH": str(Path(__file__).parent), "TERM": "xterm", **env},
            preexec_fn=partial(os.login_tty, follower),
        )
        os.close(follower)
        self.output = ""
        self._decoder = codecs.getincrementaldecoder("utf-8")()
        self._seen = 0

    def wait_for(self, text: str) -> None:
        """Read until a text comes that was not waited for before."""
        while (found := self.output.find(text, self._seen)) < 0:
            assert self._read(), f"it ended without {text!r}:\n{self.output}"
        self._seen = found + len(text)

    def type(self, keys: str) -> None:
        """Press keys, once the program waits for them.

        A signal that comes between the prompt and the wait for a key is noticed by Python only at the next key.
        """
        status = Path(f"/proc/{self._process.pid}/stat")
        while status.exists() and status.read_text().rpartition(")")[2].split()[0] != "S":
            os.sched_yield()
        os.write(self._leader, keys.encode())

    def end(self) -> int:
        """Read all that is left and return the exit code."""
        while self._read():
            pass
        return self._process.wait(DEADLINE_S)

    def close(self) -> None:
        """End the process if it is still there."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        os.close(self._leader)

    def _read(self) -> bool:
        assert select.select([self._leader], [], [], DEADLINE_S)[0], f"nothing more came:\n{self.output}"
        try:
            chunk = os.read(self._leader, 65536)
        except OSError:  # how Linux reports that the other end is closed
            return False
        self.output = (self.output + self._decoder.decode(chunk)).replace("\r\n", "\n")
        return bool(chunk)
