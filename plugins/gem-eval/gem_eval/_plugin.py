"""What this distribution offers; a command is imported when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import CommandSpec, hookimpl


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The commands of this plugin."""
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
            name="compare",
            entry_point="gem_eval.comparing.command:command",
            summary="Compare runs, paired by row: differences with intervals, tests, and what flipped.",
        ),
        CommandSpec(
            name="score",
            entry_point="gem_eval.scoring.command:command",
            summary="Grade the episodes of a run again, without a model.",
        ),
        CommandSpec(
            name="replay",
            entry_point="gem_eval.replaying.command:command",
            summary="Replay a recorded episode, and go on from any of its turns.",
        ),
    ]
