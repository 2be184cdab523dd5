"""The example that plays a model server, so that the whole path can be tried offline."""

from __future__ import annotations

import importlib.util
import json
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


def test_the_scripted_server_streams(tmp_path: Path) -> None:
    """In pieces that the agent joins."""
    pytest.importorskip("gem_games")
    done = scripted(tmp_path, "gem run game:GuessTheNumber-v0 -n 2 -s 1 --agent openai:scripted --stream")
    assert (done.returncode, done.stderr) == (0, "")
    assert "100.0%" in done.stdout


def test_the_scripted_model_calls_a_tool_once() -> None:
    """With arguments that fit its schema."""
    specification = importlib.util.spec_from_file_location("scripted_server", EXAMPLE)
    assert specification is not None
    assert specification.loader is not None
    example = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(example)
    schema = {"properties": {"code": {"type": "string"}, "times": {"type": "integer"}}, "required": ["code", "times"]}
    tools = [{"type": "function", "function": {"name": "python", "parameters": schema}}]
    user = {"role": "user", "content": "What is 6 times 7?"}
    _, (call,) = example.answer([user], tools)
    assert json.loads(call["function"]["arguments"]) == {"code": "print(6 * 7)", "times": 6}
    text, calls = example.answer([user, {"role": "tool", "tool_call_id": "call_0", "content": "42"}], tools)
    assert (text, calls) == (r"I am a script, and I say \boxed{42}.", [])
