"""What this distribution offers; it imports no task and no engine."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from gem_core.registry import CommandSpec, EnvSpec, hookimpl


@hookimpl
def gem_register_envs() -> Iterable[EnvSpec]:
    """The tasks that ship with the plugin, and any folder; a machine is never the same twice, so none is exact."""
    folder = EnvSpec(
        id="terminal:Folder",
        entry_point="gem_terminal:TerminalEnv",
        summary="Work in a terminal; tasks of Terminal-Bench or Harbor in a folder of yours (path=…).",
        kwargs={"max_turns": 50},
        tags=("terminal", "text", "tools"),
        requires=("docker",),  # the probe is in gem-tools
        deterministic=False,
    )
    for name, form, summary in (
        ("Sample", "harbor", "Work in a terminal; tasks that ship with the plugin."),
        ("Sample-terminal-bench", "terminal-bench", "The tasks of terminal:Sample in the format of Terminal-Bench."),
    ):
        kwargs = {"path": f"gem_terminal:sample/{form}", **folder.kwargs}
        yield replace(folder, id=f"terminal:{name}", kwargs=kwargs, summary=summary)
    yield replace(folder, folder_markers=("task.toml", "task.yaml"))


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
