"""What a shell completes, asked as the shells ask."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete

import gem_core as gem
from gem_core.cli import cli
from gem_core.errors import PluginError
from gem_core.registry import lookup as registry
from gem_core.registry.lookup import Registry
from gem_core.registry.plugins import Plugin


@pytest.fixture(autouse=True)
def few(own_registry: Registry) -> None:
    """Environments of two namespaces, and what the core offers."""
    gem.register("one:Alpha-v0", "toys:CountdownEnv", summary="The first.")
    gem.register("one:Beta-v0", "toys:CountdownEnv")
    gem.register("two:Alpha-v0", "toys:CountdownEnv")
    gem.register("game:Duel-v0", "joint_toys:CountdownEnv", seats=("white", "black"))


def completed(*words: str) -> list[str]:
    """Return what is offered for the last word."""
    *args, incomplete = words
    completer = ShellComplete(cli, {}, "gem", "_GEM_COMPLETE")
    return [item.value for item in completer.get_completions(list(args), incomplete)]


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("inf",), ["info"]),
        (("--tra",), ["--traceback"]),
        (("info", "one:"), ["one:Alpha-v0", "one:Beta-v0"]),
        (("info", "concat_w"), ["concat_with_action"]),
        (("play", "one:Alpha-v0", "-w", "latest,tur"), ["latest,turn_limit"]),
        (("run", "--backend", "a"), ["async", "auto"]),
        (("plugins", "c"), ["core"]),
        (("info", "three:"), []),
        (("run", "game:Duel-v0", "--agent", "black=ran"), ["black=random"]),
    ],
)
def test_words_are_completed(words: tuple[str, ...], offered: list[str]) -> None:
    """Commands, options, ids, agents, wrappers and plugins."""
    assert completed(*words) == offered


def test_broken_plugin_says_nothing_while_somebody_types(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Not even in strict mode; the command itself will tell."""

    def fail() -> list[Plugin]:
        raise PluginError("a plugin failed")

    monkeypatch.setattr(registry, "load_plugins", fail)
    monkeypatch.setattr(registry, "_registry", Registry())
    assert completed("info", "one") == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes_words_with_colons(monkeypatch: pytest.MonkeyPatch) -> None:
    """The script makes the colon part of a word."""
    monkeypatch.setenv("_GEM_COMPLETE", "bash_source")
    script = subprocess.run([sys.executable, "-m", "gem_core"], capture_output=True, text=True, check=True).stdout
    assert "complete -o nosort -F _gem_completion gem" in script
    command = f'COMP_WORDBREAKS=" =:"\n{script}\necho "$COMP_WORDBREAKS"'
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout == " =\n"


@pytest.mark.parametrize("command", ["run", "play"])
def test_completing_options_loads_nothing_heavy(command: str) -> None:
    """A shell asks at every press of the key."""
    code = (
        "import sys\nfrom click.shell_completion import ShellComplete\nfrom gem_core.cli import cli\n"
        "ShellComplete(cli, {}, 'gem', '_GEM_COMPLETE').get_completions([NAME, '--wrappers'], 'c')\n"
        "print([name for name in ('gymnasium', 'numpy', 'pydantic', 'rich') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", f"NAME = {command!r}\n{code}"], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout == "[]\n"
