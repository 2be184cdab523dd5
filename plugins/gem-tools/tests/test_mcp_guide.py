"""The example of the guide to MCP servers runs as it stands, and its configuration is read."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from gem_core.parsing import extract_code_blocks
from gem_tools.mcp.config import read_config

GUIDE = (Path(__file__).parents[3] / "docs" / "mcp.md").read_text("utf-8")


@pytest.mark.thorough
def test_the_mcp_example_runs(tmp_path: Path) -> None:
    """And solves its task, after a call that the server refuses."""
    server, agent = (block.code for block in extract_code_blocks(GUIDE, "python"))
    (tmp_path / "notes.py").write_text(server, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", agent], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.stderr == ""
    assert "- read_note: Reads a note again. Call it with <tool_call>" in done.stdout
    assert "Output of add_note:\nThis is note 1." in done.stdout
    assert "Error from read_note:\n" in done.stdout
    assert "Output of read_note:\nmilk" in done.stdout
    assert done.stdout.endswith("\n1.0\n")


def test_the_configuration_is_read(monkeypatch, tmp_path):
    monkeypatch.setenv("TICKETS_TOKEN", "t")
    example, memory = (block.code for block in extract_code_blocks(GUIDE, "json"))
    path = tmp_path / "servers.json"
    path.write_text(example, encoding="utf-8")
    files, tickets = read_config(path)
    assert files.args[-1] == str(tmp_path)
    assert tickets.headers == (("Authorization", "Bearer t"),)
    assert dict(read_config(json.loads(memory))[0].in_folder("x").env) == {"MEMORY_FILE_PATH": "x/memory.jsonl"}
