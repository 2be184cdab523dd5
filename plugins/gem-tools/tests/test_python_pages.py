"""The examples of the README and of the guide to the Python tool run as they stand."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from gem_core.parsing import extract_code_blocks

PLUGIN = Path(__file__).parent.parent
PAGES = {
    "README": PLUGIN / "README.md",
    "guide": PLUGIN.parent.parent / "docs" / "python-tool.md",
}


@pytest.mark.parametrize(
    ("page", "mark", "wanted"),
    [
        ("README", "primes", "Output of python:\n168\n"),
        ("guide", "primes", "Output of python:\n168\n"),
        ("guide", "shared_pool", "ok 42\n\n"),
    ],
    ids=["README", "tool", "pool"],
)
def test_the_python_examples_run(page: str, mark: str, wanted: str) -> None:
    """And print what they say."""
    blocks = [block.code for block in extract_code_blocks(PAGES[page].read_text("utf-8"), "python")]
    (code,) = [block for block in blocks if mark in block]
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=120)
    # Where nothing stronger than the level `process` works, one line says so.
    assert [line for line in done.stderr.splitlines() if "weakest level" not in line] == []
    assert wanted in done.stdout
    if "1.0" in code:
        assert done.stdout.endswith("\n1.0\n")
