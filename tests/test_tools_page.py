"""Every example of the page on tools runs as it stands."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from gem_core.parsing import extract_code_blocks
from gem_core.tools.env import ToolEnv

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "tools.md").read_text(encoding="utf-8")
BLOCKS = extract_code_blocks(PAGE)


@pytest.mark.parametrize("code", [block.code for block in BLOCKS], ids=range(len(BLOCKS)))
def test_examples_run(code: str, tmp_path: Path) -> None:
    """Pasted into a file, in an empty folder, without a warning."""
    (tmp_path / "example.py").write_text(code, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error", "example.py"],
        cwd=tmp_path,
        env=dict(os.environ),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert done.stderr == ""


def test_every_block_is_an_example() -> None:
    """All blocks are Python, so that the test above runs each of them."""
    assert {block.language for block in BLOCKS} == {"python"}


def test_every_option_stands_in_the_table() -> None:
    """With its default, so that the page does not fall behind."""
    rows = dict(re.findall(r"^\| `(\w+)` \| ([^|]+) \|", PAGE, re.MULTILINE))
    options = list(inspect.signature(ToolEnv.__init__).parameters.values())[3:]
    assert [option.name for option in options] == list(rows)
    for option in options:
        default = f"{option.default:g}" if isinstance(option.default, float) else str(option.default)
        assert rows[option.name].strip('`"') == default


def test_every_file_that_the_page_names_is_there() -> None:
    """Links, and paths in backticks."""
    named = re.findall(r"\]\((?!http)([^)#]+)\)", PAGE)
    named += re.findall(r"`((?:gem_core|plugins|docs|benchmarks)/[^`]*)`", PAGE)
    assert [path for path in named if not (ROOT / path).exists() and not (ROOT / "docs" / path).exists()] == []
