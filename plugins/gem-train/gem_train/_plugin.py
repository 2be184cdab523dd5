"""What this distribution offers; a command is imported when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import CommandSpec, hookimpl


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The commands that train."""
    return []
