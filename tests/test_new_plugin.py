"""``gem new-plugin``: what it writes is right as it stands, and what it refuses."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from distributions import add_metadata

import gem_core
from gem_core.cli.new_plugin import KINDS, names_of, render, write
from gem_core.errors import ArgumentError

ROOT = Path(__file__).parent.parent
CHOICES = [list(KINDS), *([kind] for kind in KINDS), ["tool", "wrapper"]]
LONGEST = "a-plugin-of-the-longest-name-0"


def ids(kinds: object) -> str:
    return "+".join(kinds) if isinstance(kinds, list) else str(kinds)


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a module of Python in the folder of a plugin."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("GEM_", "PYTEST_"))}
    path = os.pathsep.join([str(cwd), str(Path(gem_core.__file__).parent.parent)])
    command = [sys.executable, "-W", "error", "-m", *arguments]
    return subprocess.run(
        command, cwd=cwd, env={**variables, "PYTHONPATH": path}, capture_output=True, text=True, timeout=300
    )


@pytest.mark.skipif(shutil.which("ruff", path=str(Path(sys.executable).parent)) is None, reason="ruff is not installed")
def test_what_is_written_is_formatted_and_clean(tmp_path: Path) -> None:
    """By the rules of this repository, whatever the name."""
    for number, kinds in enumerate(CHOICES):
        for name in "x", LONGEST:
            folder = tmp_path / f"{name}-{number}"
            write(folder, render(names_of(name), kinds))
            (folder / "pyproject.toml").unlink()  # its settings would stand in for ours
    ruff = [str(Path(sys.executable).parent / "ruff")]
    for command in (["format", "--diff"], ["check", "--no-cache"]):
        config = ["--config", str(ROOT / "pyproject.toml")]
        done = subprocess.run([*ruff, *command, *config, "."], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("kinds", CHOICES, ids=ids)
@pytest.mark.few(1)  # the first, which has everything
def test_generated_tests_pass(kinds: list[str], tmp_path: Path) -> None:
    """Installed, it is found, declares only, and keeps every promise that it is held to, without a warning."""
    folder = tmp_path / "gem-mine"
    write(folder, render(names_of("mine"), kinds))
    add_metadata(folder, tomllib.loads((folder / "pyproject.toml").read_text())["project"])
    arguments = ["pytest", "-q", "-p", "no:cacheprovider"]
    if len(kinds) == 1:  # the conformance of each is tried in the combination of all
        arguments += ["-k", "not contract"]
    done = run(*arguments, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", ["", "a b", "1a", "a--b", "é", "../x", "x" * 31, "a\n", "class", "gem-core"])
def test_impossible_names_are_refused(name: str) -> None:
    """With what a name looks like."""
    with pytest.raises(ArgumentError, match=re.escape(repr(name))):
        names_of(name)


def test_command_prints_three_commands_to_go_on_with(run_gem, tmp_path: Path) -> None:
    """Install, try, test; without an option, an environment."""
    assert names_of("gem-My_Games").distribution == "gem-my-games"
    assert run_gem("new-plugin", "mine").out.splitlines() == [
        "Wrote 10 files to gem-mine. Go on with:",
        "  python -m pip install -e './gem-mine[test]'",
        "  gem run mine:Letters-v0 --episodes 5 --seed 1",
        "  python -m pytest gem-mine",
    ]
    assert (tmp_path / "gem-mine" / "gem_mine" / "env.py").is_file()


@pytest.mark.parametrize("make", [Path.touch, lambda path: (path.mkdir(), (path / "notes").touch())])
def test_nothing_is_overwritten(make: Callable[[Path], object], run_gem, tmp_path: Path) -> None:
    """Neither a file nor a folder that has anything in it."""
    make(tmp_path / "gem-mine")
    before = sorted(tmp_path.rglob("*"))
    assert run_gem("new-plugin", "mine", "--into", str(tmp_path / "gem-mine")).code == 2
    assert sorted(tmp_path.rglob("*")) == before


def test_installed_plugin_is_not_begun_again(run_gem) -> None:
    """Neither its name nor its namespace can be had twice."""
    refused = run_gem("new-plugin", "toy")
    assert refused.code == 2
    assert "'toy'" in refused.err
