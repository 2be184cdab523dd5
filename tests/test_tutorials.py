"""Each tutorial is followed to the letter from an empty folder, and what it shows is what comes out.

In a tutorial a block with a title is the file of that name; ``console`` blocks are typed, in one shell, from top to
bottom; and a ``text`` block is the output of the block before it, in which ``…`` stands for anything. A ``console``
block with a title is for elsewhere, as with a model or on a GPU.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from tutorial_steps import agrees, follow, shown_outputs, steps_of

from gem_core.parsing import extract_code_blocks

ROOT = Path(__file__).parent.parent
TUTORIALS = {path.stem: path for path in sorted((ROOT / "docs" / "tutorials").glob("*.md")) if path.stem != "index"}
NEEDS = {
    "data-set": ("gem_core",),
    "model": ("gem_games", "gem_openai", "gem_eval"),
    "terminal-tasks": ("gem_terminal",),
    "training": ("gem_train", "torch"),
    "first-episode": ("gem_games", "gem_eval"),
}
"""Packages that a tutorial uses; the others need the games."""
QUICK = {"first-episode"}
"""Followed each time; all others with --thorough, since each command starts an interpreter."""
ELSEWHERE = {
    "Install",
    "On a GPU",
    "To PyPI",
    "With a model",
    "With a model of OpenAI",
    "With vLLM, SGLang or another server of your own",
}


def text_of(name: str) -> str:
    """Return a tutorial."""
    return TUTORIALS[name].read_text(encoding="utf-8")


def variables(folder: Path) -> dict[str, str]:
    """Return an environment in which this interpreter's commands come first, and nothing is set for GEM."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("GEM_", "PYTEST_", "PIP_"))}
    return kept | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "HOME": str(folder),
    }


def base_image() -> str:
    """Return the image of tests, which stands for the one that a tutorial names; skip without it."""
    image = os.environ.get("GEM_TERMINAL_BASE_IMAGE", "gem-python:base")
    inspect = ["docker", "image", "inspect", image]
    if shutil.which("docker") is None or subprocess.run(inspect, capture_output=True, check=False).returncode:
        pytest.skip(f"no engine answers that has the image {image}: name one with GEM_TERMINAL_BASE_IMAGE")
    return image


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in QUICK else pytest.mark.thorough) for name in TUTORIALS if name != "plugin"],
)
def test_tutorial_works_to_the_letter(name: str, tmp_path: Path) -> None:
    """Every command succeeds, and every output that is shown comes out."""
    for package in NEEDS.get(name, ("gem_games",)):
        pytest.importorskip(package)
    env = variables(tmp_path)
    if name == "terminal-tasks":
        env["GEM_TERMINAL_BASE_IMAGE"] = base_image()
    folder = tmp_path / "empty"
    folder.mkdir()
    if name == "model":
        shutil.copy(ROOT / "examples" / "scripted_server.py", folder)
    steps = steps_of(text_of(name))
    for shown, output in shown_outputs(steps, follow(steps, folder, env)):
        assert agrees(shown, output), f"shown:\n{shown}\ncame out:\n{output}"


@pytest.mark.thorough
def test_plugin_tutorial_ends_with_a_wheel_in_a_fresh_environment(tmp_path: Path) -> None:
    """With real environments and a real wheel of the core; pip finds what the core needs without a network."""
    wheels, needed, folder = tmp_path / "wheels", tmp_path / "needed", tmp_path / "empty"
    for path in (wheels, needed, folder):
        path.mkdir()
    for path in Path(sysconfig.get_path("purelib")).iterdir():
        if not path.name.startswith(("gem_", "_gem_", "__editable__", "_virtualenv", "pip")):
            (needed / path.name).symlink_to(path)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(wheels)]
    subprocess.run([*build, str(ROOT)], check=True)
    offline = {
        "PYTHONPATH": str(needed),
        "PIP_NO_INDEX": "1",
        "PIP_FIND_LINKS": str(wheels),
        "PIP_NO_BUILD_ISOLATION": "0",  # pip reads this variable the other way round
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
    }
    steps = steps_of(text_of("plugin"))
    outputs = follow(steps, folder, variables(tmp_path) | offline)
    for shown, output in shown_outputs(steps, outputs):
        assert agrees(shown, output), f"shown:\n{shown}\ncame out:\n{output}"


@pytest.mark.parametrize("name", TUTORIALS)
def test_tutorial_is_short_and_complete(name: str) -> None:
    """At most 900 words; all of its blocks are known."""
    text = text_of(name)
    assert len(text.split()) <= 900
    steps = steps_of(text)
    assert len(steps) == len(extract_code_blocks(text))
    for step in steps:
        assert step.title or step.language in ("console", "text")
        if step.language == "console" and step.title:
            assert step.title in ELSEWHERE
        if step.language == "python":
            ast.parse(step.code)


def test_drawings_are_what_the_script_makes() -> None:
    """After a change, run ``python scripts/drawings.py``."""
    done = subprocess.run(
        [sys.executable, "scripts/drawings.py", "--check"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_shown_output_is_compared() -> None:
    """To the letter, but for what ``…`` stands for."""
    assert agrees("a … c\n…\nz\n", "a b c\nd\nz\n\n")
    assert not agrees("a … c\n", "a b\nc\n")
    assert not agrees("a\n", "a\nb\n")
