"""The example of the guide to search runs as it stands."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from gem_core.parsing import extract_code_blocks

GUIDE = Path(__file__).parents[3] / "docs" / "search.md"


def test_the_search_example_runs(tmp_path: Path) -> None:
    """And solves its task."""
    code = next(
        block.code for block in extract_code_blocks(GUIDE.read_text("utf-8"), "python") if "search" in block.code
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env={"XDG_CACHE_HOME": str(tmp_path), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.stderr == ""
    assert "[1] HMS Endeavour" in done.stdout
    assert done.stdout.endswith("\n1.0\n")
