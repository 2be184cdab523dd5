"""``gem completion``: the script that lets a shell complete the words of ``gem``."""

from __future__ import annotations

import os
import sys

import click

from gem_core.cli.completion import SHELLS
from gem_core.cli.documented import Documented


@click.command("completion", cls=Documented)
@click.argument("shell", type=click.Choice(list(SHELLS)), required=False)
def command(shell: str | None) -> None:
    """Print the script that completes words in bash, zsh or fish.

    Without an argument it is the shell that $SHELL names. Let your shell's start-up file load it, as below.

    Examples:
      bash  echo 'eval "$(gem completion bash)"' >> ~/.bashrc
      zsh   echo 'eval "$(gem completion zsh)"' >> ~/.zshrc
      fish  gem completion fish > ~/.config/fish/completions/gem.fish

    It completes commands, options, ids, agents, suites, wrappers and tools (also after a comma), plugins and
    files. Start a new shell, then try:
      gem info <Tab>

    If another program is called gem, complete gem-core instead:
      eval "$(gem-core completion bash)"
    """
    if shell is None:
        shell = os.path.basename(os.environ.get("SHELL", ""))
        if shell not in SHELLS:
            raise click.UsageError(f"name a shell: {', '.join(SHELLS)}")
    program = "gem-core" if os.path.basename(sys.argv[0]) == "gem-core" else "gem"
    root = click.get_current_context().find_root().command
    click.echo(SHELLS[shell](root, {}, program, "_GEM_COMPLETE").source(), nl=False)
