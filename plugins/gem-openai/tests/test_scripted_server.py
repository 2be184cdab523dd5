"""The example that plays a model server, so that the whole path can be tried offline."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "scripted_server.py"


def scripted(tmp_path: Path, command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(EXAMPLE), "--run", command],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_the_one_command_of_the_readme_wins_the_game(tmp_path: Path) -> None:
    """Offline, from nothing."""
    pytest.importorskip("gem_games")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (command,) = re.findall(r'^python examples/scripted_server\.py --run "(.+)"$', readme, re.MULTILINE)
    done = scripted(tmp_path, command)
    assert (done.returncode, done.stderr) == (0, "")
    assert "100.0%" in done.stdout
