"""The examples of the plugin's README and of its guide run, and the tables say what there is."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from gem_core.parsing import extract_code_blocks
from gem_math.listing import math_specs
from gem_math.math_env import MathEnv

README = Path(__file__).parents[1].joinpath("README.md").read_text(encoding="utf-8")
GUIDE = Path(__file__).parents[3].joinpath("docs", "mathematics.md").read_text(encoding="utf-8")
PYTHON = [block.code for page in (README, GUIDE) for block in extract_code_blocks(page, "python")]
COMMANDS = [
    line
    for block in extract_code_blocks(README, "console")
    for line in block.code.splitlines()
    if line.startswith("gem ")
]


@pytest.mark.parametrize("code", PYTHON, ids=lambda code: code[:40])
@pytest.mark.few(1)
def test_python_example_runs(code: str, tmp_path: Path):
    """Pasted into a file, in an empty folder, without a warning."""
    (tmp_path / "example.py").write_text(code, encoding="utf-8")
    command = [sys.executable, "-W", "error", "example.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.thorough
def test_answers_of_the_examples_are_right(tmp_path: Path):
    """The examples show what their text says."""
    (tmp_path / "example.py").write_text(PYTHON[0], encoding="utf-8")
    done = subprocess.run([sys.executable, "example.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.stdout.endswith("1.0 212 dollars it equals the reference\n")
    (tmp_path / "example.py").write_text(PYTHON[1], encoding="utf-8")
    done = subprocess.run([sys.executable, "example.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.stdout == "1.0 it equals the reference\n" * 2
    (tmp_path / "example.py").write_text(PYTHON[2], encoding="utf-8")
    done = subprocess.run([sys.executable, "example.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    verdicts = [line.partition("correct=")[2].partition(",")[0] for line in done.stdout.splitlines()]
    assert verdicts == ["True", "True", "False", "True", "True", "False", "False"]


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.few(1)
def test_command_runs(command: str, tmp_path: Path):
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
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_table_names_the_data_sets():
    """Every id that this plugin has for data sets, and no other."""
    assert re.findall(r"^\| `((?:math|eval):[^`]+)`", README, re.MULTILINE) == [spec.id for spec in math_specs()]


def test_table_names_the_keywords():
    """Every keyword of MathEnv's own, and no other."""
    table = re.findall(r"^\| `(\w+)=", README, re.MULTILINE)
    own = [
        name
        for name, parameter in inspect.signature(MathEnv).parameters.items()
        if parameter.kind.name == "KEYWORD_ONLY"
    ]
    assert sorted(table) == sorted(own)
