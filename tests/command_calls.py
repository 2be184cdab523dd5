"""Calls of the command ``gem``: in this process, or in one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

PROGRAM = "from toys import register_toys\nregister_toys()\nfrom gem_core.__main__ import main\nmain()"


@dataclass
class Outcome:
    """What one call of the command did."""

    code: int
    out: str
    err: str


RunGem = Callable[..., Outcome]


def subprocess_gem(*arguments: str, cwd: Path, code: str = "") -> subprocess.CompletedProcess[str]:
    """Call the command in a process of its own, with the toys on its path."""
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    return subprocess.run(
        [sys.executable, "-c", f"{code}\n{PROGRAM}", *arguments],
        cwd=cwd,
        env=env,
        capture_output=True,
        text=True,
        timeout=60,
    )
