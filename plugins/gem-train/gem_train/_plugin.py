"""What this distribution offers; a command is imported when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import AgentSpec, CommandSpec, hookimpl
from gem_core.registry import EnvSpec


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
def gem_register_envs() -> Iterable[EnvSpec]:
    """A task with images that a small policy learns in minutes."""
    return [
        EnvSpec(
            id="train:Shapes-v0",
            entry_point="gem_train.shapes:ShapesEnv",
            summary="How many shapes are in a small picture, which ones, of which colour?",
            tags=("image",),
            requires=("package:gem-train[vision]",),
        )
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
