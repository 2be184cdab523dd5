"""For `make docs-pages`, after an option changed: write docs/reference/commands.md, what each ``--help`` says.

    python scripts/command_reference.py

Needs all plugins of this repository. The lines are as long as in a terminal of 80 columns, whatever the terminal is.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from gem_core.cli import cli

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "commands.md"
WIDTH = 80
INTRODUCTION = """# Commands

The command `gem` with every plugin installed. Each part is what `--help` prints, as in `gem list --help`.
"""


def page() -> str:
    """Return the text of the page."""
    parts = [f"## {context.command_path}\n\n```text\n{context.get_help()}\n```\n" for context in contexts(cli, None)]
    return "\n".join([INTRODUCTION, *parts])


def contexts(command: click.Command, parent: click.Context | None) -> Iterator[click.Context]:
    """Yield a context for a command and for each of its subcommands."""
    name = command.name if parent else "gem"
    context = click.Context(
        command, parent=parent, info_name=name, terminal_width=WIDTH, color=False, **command.context_settings
    )
    yield context
    if isinstance(command, click.Group):
        for subcommand in command.list_commands(context):
            found = command.get_command(context, subcommand)
            if found and not found.hidden:
                yield from contexts(found, context)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(f"wrote {PAGE.name}")
