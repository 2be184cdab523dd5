"""Running the scripts of a task, each in a process of its own with a clean environment."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

MAX_OUTPUT_CHARS = 4000


@dataclass(frozen=True)
class Finished:
    """How a script ended.

    Args:
        exit_code: None where it ran past the limit; negative where a signal ended it.
        output: The end of what it printed, its errors included.
    """

    exit_code: int | None
    output: str

    @property
    def last_line(self) -> str:
        """The last line of the output that is not empty."""
        return next((line.strip() for line in reversed(self.output.splitlines()) if line.strip()), "")


def run_script(script: Path, arguments: Sequence[str], variables: Mapping[str, str], limit_s: float) -> Finished:
    """Run a Python script; end it, and all processes that it started in its group, after ``limit_s`` seconds."""
    with tempfile.TemporaryDirectory(prefix="gem-mcpmark-") as home, tempfile.TemporaryFile() as output:
        env = {
            "PATH": os.environ.get("PATH", os.defpath),
            "HOME": home,
            "TMPDIR": home,
            "LANG": "C.UTF-8",
            "PYTHONUTF8": "1",  # MCPMark's scripts print symbols beyond ASCII
            "PYTHONDONTWRITEBYTECODE": "1",  # a folder of the user's stays as it is
            **{name: os.environ[name] for name in ("PYTHONPATH",) if name in os.environ},  # where psycopg2 may be
            **variables,
        }
        process = subprocess.Popen(
            [sys.executable, str(script), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            cwd=script.parent,
            env=env,
            start_new_session=True,
        )
        exit_code: int | None = None
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                exit_code = process.wait(limit_s)
        finally:
            # The group is there until all of its processes have ended.
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        size = output.seek(0, os.SEEK_END)
        output.seek(max(0, size - 4 * MAX_OUTPUT_CHARS))
        return Finished(exit_code, output.read().decode(errors="replace")[-MAX_OUTPUT_CHARS:])
