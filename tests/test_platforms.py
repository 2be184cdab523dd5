"""Linux and macOS: what cannot work on Windows says so in one sentence, and the rest can be imported there."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

from gem_core.errors import MissingRequirementError


@pytest.mark.parametrize(
    ("module", "what"),
    [
        ("gem_tools.python", "the tool 'python'"),
        ("gem_terminal.command", "the command 'terminal'"),
        ("gem_math.reasoning.library", "rg:*"),
    ],
)
def test_what_needs_posix_refuses_windows(module: str, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """When it is imported, before anything that Windows lacks."""
    pytest.importorskip(module.partition(".")[0])
    monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(MissingRequirementError) as caught:
        importlib.import_module(module)
    assert str(caught.value) == f"{what} cannot run on Windows: it needs Linux or macOS; use WSL"


def test_the_core_needs_no_module_of_posix() -> None:
    """Listing, and an environment in place, import none that Windows lacks."""
    code = """
import sys
sys.modules.update(dict.fromkeys(["fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"]))
import gem_core as gem
gem.list_envs()
gem.register("mine:Sum-v0", gem.DatasetEnv, rows=[{"question": "1+1?", "answer": "2"}])
with gem.make_vec("mine:Sum-v0", 2) as vec:
    vec.reset()
    print(vec.step([r"\\boxed{2}"] * 2).rewards)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.stdout == "[1. 1.]\n", done.stderr
