"""What a shell completes, asked as the shells ask."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
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


def test_older_releases_of_click_do() -> None:
    """Before 8.5 click has no generic ``CompletionItem``, and without completion no command can be imported."""
    older = "from click import shell_completion\nshell_completion.CompletionItem = type('CompletionItem', (), {})\n"
    program = f"{older}import gem_core.cli.list_command"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("inf",), ["info"]),
        (("--tra",), ["--traceback"]),
        (("info", ""), ["game:", "one:", "two:"]),
        (("info", "one:"), ["one:Alpha-v0", "one:Beta-v0"]),
        (("info", "concat_w"), ["concat_with_action"]),
        (("play", "one:Alpha-v0", "-w", "latest,tur"), ["latest,turn_limit"]),
        (("run", "-w", "latest,episode_stats,tur"), ["latest,episode_stats,turn_limit"]),
        (("run", "--backend", "a"), ["async", "auto"]),
        (("plugins", "c"), ["core"]),
        (("completion", "z"), ["zsh"]),
        (("info", "three:"), []),
        (("run", "game:Duel-v0", "--agent", "black=ran"), ["black=random"]),
    ],
)
def test_words_are_completed(words: tuple[str, ...], offered: list[str]) -> None:
    """Commands, options, ids, agents, wrappers and plugins."""
    assert completed(*words) == offered


def test_every_command_completes_ids_and_agents() -> None:
    """Also those of plugins: whatever calls its value an ID, an AGENT or a RUN has words or files to offer."""
    named = {"ID": "one:A", "AGENT": "ran", "RUN": ""}
    for path, param in _parameters(cli, click.Context(cli)):
        wanted = next((word for word in named if word in re.split(r"\W+", param.metavar or "")), None)
        if wanted and not isinstance(param.type, click.types.IntParamType):
            context = click.Context(click.Command("gem"), resilient_parsing=True)
            assert param.shell_complete(context, named[wanted]), f"{path}: {param.opts} completes no {wanted}"


def _parameters(command: click.Command, context: click.Context) -> Iterator[tuple[str, click.Parameter]]:
    for param in command.params:
        yield context.command_path, param
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from _parameters(below, click.Context(below, parent=context, info_name=name))


def test_summary_is_the_help_of_an_id() -> None:
    """Shells that can show it do."""
    (item,) = ShellComplete(cli, {}, "gem", "_GEM_COMPLETE").get_completions(["info"], "one:A")
    assert item.help == "The first."


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


TRY = """
source "$1"
compopt() { :; }
COMP_LINE=$2 COMP_POINT=${#2}
_gem_completion gem
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def gem_on_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A command ``gem`` that knows the toys."""
    script = tmp_path / "gem"
    code = f"import sys\nsys.path.insert(0, {str(Path(__file__).parent)!r})\nfrom toys import register_toys"
    script.write_text(f"#!{sys.executable}\n{code}\nregister_toys()\nfrom gem_core.cli import main\nmain()\n")
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    return script


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("gem inf", ["info"]),
        ("gem info toy:Countd", ["Countdown-v0"]),
        ("gem run --agent ran", ["random"]),
        ("gem run --agent white=ran", ["random"]),
        ("gem run -w latest,concat_w", ["latest,concat_with_action"]),
        ("gem run toy:Countdown-v0 --see", ["--seed"]),
    ],
)
@pytest.mark.few(2)
def test_bash_completes_words_with_colons(gem_on_path: Path, tmp_path: Path, line: str, offered: list[str]) -> None:
    """The script as bash runs it: for bash the word begins behind the last colon."""
    script = tmp_path / "completion.bash"
    script.write_text(subprocess.run([gem_on_path, "completion", "bash"], capture_output=True, text=True).stdout)
    done = subprocess.run(
        ["bash", "-c", TRY, "bash", script, line], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stderr == ""
    assert [word for word in done.stdout.splitlines() if "-v0-" not in word] == offered


@pytest.mark.parametrize(
    ("shell", "mark"),
    [("bash", "complete -o nosort -F _gem_completion gem"), ("zsh", "#compdef gem"), ("fish", "complete --no-files")],
)
def test_completion_prints_the_script(shell: str, mark: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One script for each shell."""
    cli.main(["completion", shell], prog_name="gem", standalone_mode=False)
    assert mark in capsys.readouterr().out


def test_completion_of_the_other_name(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where gem is another program, gem-core is completed."""
    monkeypatch.setattr(sys, "argv", ["/bin/gem-core"])
    cli.main(["completion", "bash"], prog_name="gem", standalone_mode=False)
    assert "complete -o nosort -F _gem_core_completion gem-core" in capsys.readouterr().out


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


def test_tools_are_completed(offer) -> None:
    """For --tools behind the last comma, and for info beside the ids; wrappers are none."""
    offer(gem.ToolSpec(name="calculator", entry_point="toys:Calculator"))
    assert completed("run", "one:Alpha-v0", "--tools", "") == ["calculator"]
    assert completed("play", "one:Alpha-v0", "--tools", "calculator,c") == ["calculator,calculator"]
    assert completed("info", "calc") == ["calculator"]
