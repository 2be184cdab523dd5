"""The examples of the README and of the page on terminal tasks run as they stand."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from docker_machines import needs_engine

from gem_core.parsing import extract_code_blocks

_PLUGIN = Path(__file__).parent.parent
PAGES = [path.read_text("utf-8") for path in (_PLUGIN / "README.md", _PLUGIN.parent.parent / "docs" / "terminal.md")]
PYTHON = [block.code for page in PAGES for block in extract_code_blocks(page, "python")]
SHELL = [block.code for page in PAGES for block in extract_code_blocks(page, "console")]
COMMANDS = [line for code in SHELL for line in code.splitlines() if not line.startswith("pip ")]


@needs_engine
@pytest.mark.parametrize("code", PYTHON, ids=range(len(PYTHON)))
@pytest.mark.few(1)
def test_python_example_runs(code: str, tmp_path: Path) -> None:
    """In an empty folder, without a warning; what its comments say is what it prints."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.stderr == ""
    printed = done.stdout.splitlines()
    for line in code.splitlines():
        said = line.rpartition("  # ")[2]
        if line.startswith("print") and said != line:
            assert said in printed


@needs_engine
@pytest.mark.parametrize("command", sorted(set(COMMANDS)))
@pytest.mark.thorough
def test_command_runs(command: str, tmp_path: Path) -> None:
    """Typed into a shell, in an empty folder."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "-c", command],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout
