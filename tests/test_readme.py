"""Every example of the README runs as it stands."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from gem_core.parsing import CodeBlock, extract_code_blocks

pytest.importorskip("gem_games", reason="the README's examples play games; install plugins/gem-games")
pytest.importorskip("gem_eval", reason="the README's examples show episodes; install plugins/gem-eval")

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(*languages: str) -> list[CodeBlock]:
    return extract_code_blocks(README, *languages)


def run(command: list[str], cwd: Path, **env: str) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        command, cwd=cwd, env={**os.environ, **env}, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.parametrize(
    "code", [b.code for b in blocks("python") if not b.code.startswith("# gem_mine/")], ids=lambda code: code[:60]
)
def test_python_examples_run(code: str, tmp_path: Path) -> None:
    """Pasted into a file, in an empty folder, without a warning."""
    (tmp_path / "example.py").write_text(code, encoding="utf-8")
    done = run([sys.executable, "-W", "error", "example.py"], tmp_path)
    assert done.stdout
    assert done.stderr == ""


@pytest.mark.parametrize(
    "commands",
    [
        commands
        for block in blocks("console")
        if (commands := [line for line in block.code.splitlines() if line.startswith(("gem ", "printf "))])
    ],
    ids=lambda commands: commands[0],
)
def test_gem_commands_run(commands: list[str], tmp_path: Path) -> None:
    """Typed into a shell, those of one block one after the other in an empty folder."""
    bin_folder = str(Path(sys.executable).parent)
    for command in commands:
        done = run(["sh", "-c", command], tmp_path, PATH=f"{bin_folder}{os.pathsep}{os.environ['PATH']}")
        assert done.stdout, command


def test_the_plugin_of_the_readme_is_found(tmp_path: Path) -> None:
    """Its declaration, installed as the README says, is listed without importing its environment."""
    (declaration,) = [b.code for b in blocks("python") if b.code.startswith("# gem_mine/_plugin.py")]
    (metadata,) = [b.code for b in blocks("toml")]
    (tmp_path / "gem_mine").mkdir()
    (tmp_path / "gem_mine" / "__init__.py").touch()
    (tmp_path / "gem_mine" / "_plugin.py").write_text(declaration, encoding="utf-8")
    group, entry = re.findall(r'entry-points\."(.+?)"\]\n(.+)', metadata)[0]
    installed = tmp_path / "gem_mine-0.1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: gem-mine\nVersion: 0.1.0\n")
    (installed / "entry_points.txt").write_text(f"[{group}]\n{entry.replace(chr(34), '')}\n")
    listed = run([sys.executable, "-m", "gem_core", "list", "mine"], tmp_path, PYTHONPATH=str(tmp_path))
    assert listed.stdout.split()[0] == "mine:Reverse-v0"
    assert listed.stderr == ""


def test_the_two_commands_are_targets_of_the_makefile() -> None:
    """What the README tells a newcomer to type is there."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    commands = [line for b in blocks("console") for line in b.code.splitlines() if line.startswith("make ")]
    assert [command.split()[1] for command in commands] == ["demo", "test"]
    for command in commands:
        assert re.search(rf"^{command.split()[1]}:", makefile, re.MULTILINE)


def test_every_file_that_the_readme_names_is_there() -> None:
    """Links and paths in backticks."""
    named = re.findall(r"\]\((?!http)([^)#]+)\)", README) + re.findall(r"`((?:gem_core|plugins|docs)/[^`]*)`", README)
    missing = [path for path in named if not (ROOT / path).exists()]
    assert missing == []
