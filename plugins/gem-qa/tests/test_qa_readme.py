"""The examples of the README run as they stand."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gem_core.parsing import extract_code_blocks

README = (Path(__file__).parent.parent / "README.md").read_text("utf-8")
PYTHON = [block.code for block in extract_code_blocks(README, "python")]
TYPED = [line for block in extract_code_blocks(README, "console") for line in block.code.splitlines()]
COMMANDS = [line for line in TYPED if line.startswith("gem ")]


@pytest.mark.parametrize("code", PYTHON, ids=lambda code: code.splitlines()[2][:40])
def test_python_example_runs(code: str, tmp_path: Path) -> None:
    """In an empty folder, without a warning; numbers in its comments are those that it prints."""
    if "search" in code:
        pytest.importorskip("gem_tools", reason="the search tool comes with gem-tools")
    command = [sys.executable, "-W", "error", "-c", code]
    variables = {"XDG_CACHE_HOME": str(tmp_path), "PATH": ""}
    done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=120)
    assert done.stderr == ""
    printed = done.stdout.splitlines()
    for line in code.splitlines():
        said = line.rpartition("  # ")[2]
        if line.startswith("print") and said != line:
            assert said in printed


@pytest.mark.parametrize("command", COMMANDS)
def test_command_runs(command: str, tmp_path: Path) -> None:
    """Typed into a shell, in an empty folder."""
    variables = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        ["sh", "-c", command], cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert "qa:Sample" in done.stdout
