"""What this distribution offers; a command is imported when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import AgentSpec, CommandSpec, hookimpl


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The commands that train."""
    return [
        CommandSpec(
            name="train",
            entry_point="gem_train.learner.command:command",
            summary="Train a small policy from scratch on a processor, in any environments of text.",
        ),
        CommandSpec(
            name="train-study",
            entry_point="gem_train.gamma_study:command",
            summary="Show a claim about training by many small runs.",
        ),
    ]


@hookimpl
def gem_register_agents() -> Iterable[AgentSpec]:
    """The agent ``train``."""
    return [
        AgentSpec(
            name="train",
            entry_point="gem_train.learner.agent:CheckpointAgent",
            summary="Plays as a policy of 'gem train' does, as train:FOLDER.",
        )
    ]
