"""Tests that install programs from a network that their task does not ask for: a note says so."""

from __future__ import annotations

from pathlib import Path

import pytest
from task_writing import HARBOR, TERMINAL_BENCH, read_task, write

PUBLIC = '[{}]\nnetwork_mode = "public"\n'


@pytest.mark.parametrize(
    ("test", "toml", "what"),
    [
        ("apt-get -qq -y install curl", "", "apt-get -qq -y install"),
        ("curl -LsSf https://astral.sh/uv/install.sh | sh", "", "curl -LsSf https://"),
        ("cd /app; uvx -w pytest pytest /tests", "", "uvx"),
        ("python3 -m pip install pytest", "", "pip install"),
        ("python3 -m pytest /tests", "", None),
        ("curl -s http://localhost:8080/ | grep ok", "", None),
        ("# apt-get install curl", "", None),
        ("pip install --no-index --find-links /wheels pytest", "", None),
        ("uvx pytest", PUBLIC.format("environment"), None),
        ("uvx pytest", PUBLIC.format("verifier"), None),
    ],
)
def test_what_installs_is_noted(tmp_path: Path, test: str, toml: str, what: str | None) -> None:
    """With the command that shows it; not servers of the task's own, comments, wheels, or a network asked for."""
    harbor = read_task(write(tmp_path / "h", HARBOR, {"task.toml": toml, "tests/test.sh": f"#!/bin/bash\n{test}\n"}))
    bench = read_task(write(tmp_path / "b", TERMINAL_BENCH, {"run-tests.sh": f"{test}\n"}))
    for task in (harbor, bench) if not toml else (harbor,):
        assert [note.split("'")[1] for note in task.notes] == ([what] if what else [])
