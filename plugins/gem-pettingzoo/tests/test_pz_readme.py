"""The examples of the README run as they stand."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from gem_core.parsing import extract_code_blocks

README = (Path(__file__).parent.parent / "README.md").read_text("utf-8")
PYTHON = [block.code for block in extract_code_blocks(README, "python")]


@pytest.mark.parametrize("code", PYTHON, ids=["make", "from", "to"])
def test_python_example_runs(code: str, tmp_path: Path) -> None:
    """In an empty folder, without a warning; comments behind what is printed are what is printed."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.stderr == ""
    assert done.stdout.splitlines() == [line.split("  # ")[1] for line in code.splitlines() if line.startswith("print")]
