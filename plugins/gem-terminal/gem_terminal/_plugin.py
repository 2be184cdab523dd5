"""What this distribution offers; it imports no task and no engine."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry import CommandSpec, EnvSpec, RequirementSpec, hookimpl

_ENTRY = "gem_terminal:TerminalEnv"
_TURNS = 50


@hookimpl
def gem_register_envs() -> Iterable[EnvSpec]:
    """The tasks that ship with the plugin, and any folder; a machine is never the same twice, so none is exact."""
    yield _sample("terminal:Sample", "harbor", "Work in a terminal; tasks that ship with the plugin.")
    name = "terminal:Sample-terminal-bench"
    yield _sample(name, "terminal-bench", "The tasks of terminal:Sample in the format of Terminal-Bench.")
    yield EnvSpec(
        id="terminal:Folder",
        entry_point=_ENTRY,
        summary="Work in a terminal; tasks of Terminal-Bench or Harbor in a folder of yours (path=…).",
        kwargs={"max_turns": _TURNS},
        tags=("terminal", "text", "tools"),
        requires=("docker",),
        deterministic=False,
        folder_markers=("task.toml", "task.yaml"),
    )


def _sample(name: str, form: str, summary: str) -> EnvSpec:
    kwargs = {"path": f"gem_terminal:sample/{form}", "max_turns": _TURNS}
    return EnvSpec(
        id=name,
        entry_point=_ENTRY,
        kwargs=kwargs,
        summary=summary,
        tags=("terminal", "text", "tools"),
        requires=("docker",),
        deterministic=False,
    )


@hookimpl
def gem_register_requirements() -> Iterable[RequirementSpec]:
    """What the machines stand on."""
    probe = "gem_core.container_engine:probe"
    return [RequirementSpec(name="docker", entry_point=probe, summary="A container engine that answers.")]


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The command that shows tasks and tries them."""
    return [
        CommandSpec(
            name="terminal",
            entry_point="gem_terminal.command:command",
            summary="List terminal tasks, and check that they can be solved.",
        )
    ]
