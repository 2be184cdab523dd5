"""The guide to writing a plugin, done as it says, from its first command to its last."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import gem_core
from gem_core.parsing import extract_code_blocks

GUIDE = (Path(__file__).parent.parent / "docs" / "writing-a-plugin.md").read_text(encoding="utf-8")
COMMANDS = [line for block in extract_code_blocks(GUIDE, "console") for line in block.code.splitlines()]


@pytest.mark.thorough
def test_every_command_of_the_guide_works(tmp_path: Path) -> None:
    """In one empty folder and in this order; pip writes into a folder of the test, not into this environment."""
    for needed in ("hatchling", "editables", "pip"):
        pytest.importorskip(needed, reason="the guide installs a plugin")
    site = tmp_path / "site"
    site.mkdir()
    # A .pth file counts only in a folder of packages: this one makes the interpreter treat ours as such.
    start = tmp_path / "start"
    start.mkdir()
    (start / "sitecustomize.py").write_text(f"import site\nsite.addsitedir({str(site)!r})\n")
    root = Path(gem_core.__file__).parent.parent
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("GEM_", "PYTEST_", "PIP_"))}
    variables |= {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(map(str, [start, root])),
        "PIP_TARGET": str(site),
        "PIP_NO_INDEX": "1",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        "PYTHONWARNINGS": "",
    }
    cwd = tmp_path
    for command in COMMANDS:
        if command.startswith("cd "):
            cwd = cwd / command.removeprefix("cd ")
            continue
        done = subprocess.run(
            ["sh", "-c", command], cwd=cwd, env=variables, capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    assert list((cwd / "dist").glob("gem_riddles-0.1.0-*.whl"))


def test_every_command_begins_with_what_a_reader_has() -> None:
    """The test above runs something, and nothing surprising."""
    assert {command.split()[0] for command in COMMANDS} == {"gem", "cd", "python"}
