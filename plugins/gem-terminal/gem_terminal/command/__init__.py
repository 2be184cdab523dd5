"""``gem terminal``: tasks to look at, their images, and what dead processes have left behind."""

from __future__ import annotations

import importlib

import click

from gem_core.errors import refuse_windows

refuse_windows("the command 'terminal'")

_COMMANDS = {
    "list": "Show tasks: their limits, and which of them cannot run here.",
    "build": "Build the images of tasks.",
    "check": "Try tasks: the reference solution must pass, and doing nothing must fail.",
    "shell": "Work in the machine of a task yourself.",
    "clean": "Remove what processes that are dead have left behind.",
}


class _Commands(click.Group):
    """Imports a subcommand when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        found: click.Command = importlib.import_module(f"gem_terminal.command.{cmd_name}_command").command
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))


@click.command(
    "terminal",
    cls=_Commands,
    epilog="""\b
Examples:
  gem terminal list
  gem terminal list my-tasks --json
  gem terminal build my-tasks --task 'git-*'
  gem terminal check my-tasks
  gem terminal shell my-tasks/fix-the-server
  gem terminal clean --images
""",
)
def command() -> None:
    """Terminal tasks: look at them, build them, try them, and clear up."""
