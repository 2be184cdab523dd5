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
DOCS = Path(__file__).parents[3] / "docs"
PAGES = [README, *((DOCS / name).read_text(encoding="utf-8") for name in ("mathematics.md", "reasoning-gym.md"))]
PYTHON = [block.code for page in PAGES for block in extract_code_blocks(page, "python")]
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
    if "rg:" in code:
        pytest.importorskip("reasoning_gym", reason="rg:* needs gem-math[reasoning-gym], which needs a C compiler")
    (tmp_path / "example.py").write_text(code, encoding="utf-8")
    command = [sys.executable, "-W", "error", "example.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.thorough
def test_answers_of_the_examples_are_right(tmp_path: Path):
    """The examples show what their text says."""
    outputs = []
    for code in PYTHON[:3]:
        done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300)
        outputs.append(done.stdout)
    assert outputs[0].endswith("1.0 212 dollars it equals the reference\n")
    assert outputs[1] == "1.0 it equals the reference\n" * 2
    verdicts = [line.partition("correct=")[2].partition(",")[0] for line in outputs[2].splitlines()]
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
