"""What this distribution offers; it imports no environment."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry import CommandSpec, hookimpl


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The command that replays the reference actions of tasks."""
    return [
        CommandSpec(
            name="tau",
            entry_point="gem_tau.command:command",
            summary="Check the tasks of tau-bench and tau2-bench by replaying their reference actions.",
        )
    ]
