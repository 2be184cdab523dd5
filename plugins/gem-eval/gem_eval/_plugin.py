"""What this distribution offers; a command is imported when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import CommandSpec, hookimpl


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The commands ``gem eval``, ``gem audit`` and ``gem show``."""
    return [
        CommandSpec(
            name="eval",
            entry_point="gem_eval.running.command:command",
            summary="Score models on suites, with intervals, and record the run.",
        ),
        CommandSpec(
            name="show",
            entry_point="gem_eval.show.command:command",
            summary="Show recorded episodes: a list, one of them, two compared, or a page.",
        ),
        CommandSpec(
            name="audit",
            entry_point="gem_eval.auditing.command:command",
            summary="Check environments: gold answers, exploits, leaks, duplicates.",
        ),
    ]
