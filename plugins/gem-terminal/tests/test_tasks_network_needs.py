"""Tests that install programs from a network that their task does not ask for: a note says so."""

from __future__ import annotations

from pathlib import Path

import pytest
from task_writing import read_task, write

TAIL = ", it seems, and the task asks for none: network='public' gives it one, the agent included."


def notes(folder: Path, test: str, toml: str = "") -> tuple[str, ...]:
    """Return the notes of a task with these tests."""
    files = {"task.toml": toml, "instruction.md": "Do it.", "environment/Dockerfile": "FROM debian:12\n"}
    return read_task(write(folder, {**files, "tests/test.sh": f"#!/bin/bash\n{test}\n"})).notes


@pytest.mark.parametrize(
    ("test", "what"),
    [
        ("apt-get -qq -y install curl", "apt-get -qq -y install"),
        ("curl -LsSf https://astral.sh/uv/install.sh | sh", "curl -LsSf https://"),
        ("cd /app; uvx -w pytest pytest /tests", "uvx"),
        ("python3 -m pip install pytest", "pip install"),
    ],
)
def test_what_installs_is_noted(tmp_path: Path, test: str, what: str) -> None:
    """With the command that shows it."""
    assert notes(tmp_path, test) == (f"tests/test.sh: needs a network for {what!r}{TAIL}",)


@pytest.mark.parametrize(
    "test",
    [
        "python3 -m pytest /tests",
        "curl -s http://localhost:8080/ | grep ok",
        "# apt-get install curl",
        "pip install --no-index --find-links /wheels pytest",
    ],
)
def test_what_needs_no_network_is_not(tmp_path: Path, test: str) -> None:
    """Servers of the task's own, comments, and what is installed from files."""
    assert notes(tmp_path, test) == ()


def test_a_network_that_the_task_asks_for_is_enough(tmp_path: Path) -> None:
    """For all of it, or for the tests alone."""
    for part in ("environment", "verifier"):
        assert notes(tmp_path, "uvx pytest", f'[{part}]\nnetwork_mode = "public"\n') == ()


def test_the_scripts_of_terminal_bench_are_looked_at_too(tmp_path: Path) -> None:
    """Which always are run from the task's folder."""
    files = {"task.yaml": "instruction: x\n", "Dockerfile": "FROM debian\n", "run-tests.sh": "uv init\nuv run pytest\n"}
    assert read_task(write(tmp_path, files)).notes == (f"run-tests.sh: needs a network for 'uv init'{TAIL}",)
