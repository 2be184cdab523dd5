"""The Python tool needs nothing but the core; what the others need are extras, which the errors name."""

from __future__ import annotations

import subprocess
import sys

import pytest

START = """
import sys
sys.modules.update(dict.fromkeys(["aiohttp", "bm25s", "httpx2", "mcp", "tenacity"]))
from gem_core.__main__ import main
from gem_core.data import DatasetEnv
from gem_core.tools import ToolEnv
def tool(*choices):
    ToolEnv(DatasetEnv([{"question": "?", "answer": "42"}]), list(choices)).close()
    print("made")
def gem(*arguments):
    sys.argv[1:] = arguments
    main()
"""


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("tool('python')", "made"),
        ("tool(('mcp', {'command': 'x'}))", 'pip install "gem-tools[mcp]"'),
        ("tool('search')", 'pip install "gem-tools[search]"'),
        ("gem('mcp', 'list', '--url', 'http://x/')", "pip install 'gem-tools[mcp]'"),
        ("gem('serve-search', 'articles')", "pip install 'gem-tools[search]'"),
    ],
)
def test_without_the_extras(code: str, said: str) -> None:
    """What needs none works; all else says what to install."""
    done = subprocess.run([sys.executable, "-c", START + code], capture_output=True, text=True, timeout=120)
    assert said in done.stdout + done.stderr
