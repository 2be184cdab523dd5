"""``gem terminal``: tasks to look at, and to try."""

from __future__ import annotations

import click

from gem_core.errors import refuse_windows

refuse_windows("the command 'terminal'")  # before the imports that Windows cannot do

from gem_terminal.command import check_command, list_command  # noqa: E402


@click.group(
    "terminal",
    epilog="""\b
Examples:
  gem terminal list
  gem terminal list my-tasks --json
  gem terminal check my-tasks
  gem terminal check my-tasks --task 'git-*'
""",
)
def command() -> None:
    """Terminal tasks: look at them, and try them."""


command.add_command(list_command.command)
command.add_command(check_command.command)
