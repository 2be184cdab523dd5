"""What this distribution offers; a command is imported when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import CommandSpec, hookimpl


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The commands that train."""
    return [
        CommandSpec(
            name="train-study",
            entry_point="gem_train.studies.command:command",
            summary="Show claims about training by many small runs.",
        ),
    ]
