"""Records of the core's own wrappers, backends, agents and commands, by the same hooks as those of plugins."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry.hookspecs import hookimpl
from gem_core.registry.specs import AgentSpec, CommandSpec, VectorBackendSpec, WrapperSpec


@hookimpl
def gem_register_wrappers() -> Iterable[WrapperSpec]:
    """Observation views, statistics and limits."""
    views = "gem_core.wrappers.views"
    return [
        WrapperSpec(name="latest", entry_point=f"{views}:Latest", summary="Show only the newest output."),
        WrapperSpec(name="concat", entry_point=f"{views}:Concat", summary="Show all outputs so far."),
        WrapperSpec(
            name="concat_with_action",
            entry_point=f"{views}:ConcatWithAction",
            summary="Show all outputs and actions so far.",
        ),
        WrapperSpec(
            name="messages",
            entry_point="gem_core.wrappers.chat:MessagesView",
            summary="Show the history as a list of chat messages.",
        ),
        WrapperSpec(
            name="concat_chat",
            entry_point="gem_core.wrappers.chat:ConcatChat",
            summary="Show the history as the text of a tokenizer's chat template.",
        ),
        WrapperSpec(
            name="episode_stats",
            entry_point="gem_core.wrappers.episode_stats:EpisodeStats",
            summary="Report return, length and duration in info['episode'] at the end.",
        ),
        WrapperSpec(
            name="turn_limit",
            entry_point="gem_core.wrappers.turn_limit:TurnLimit",
            summary="Truncate an episode after max_turns turns.",
        ),
        WrapperSpec(
            name="tools",
            entry_point="gem_core.tools.env:ToolEnv",
            summary="Offer several tools, with rewards and limits.",
        ),
    ]


@hookimpl
def gem_register_vector_backends() -> Iterable[VectorBackendSpec]:
    """The backends that need nothing but the core."""
    backends = "gem_core.vector.backends"
    return [
        VectorBackendSpec(
            name="auto",
            entry_point=f"{backends}:auto",
            summary="Chooses by what each environment says of itself.",
        ),
        VectorBackendSpec(
            name="sync",
            entry_point=f"{backends}:sync",
            summary="Steps one environment after another, in this thread.",
        ),
        VectorBackendSpec(
            name="async",
            entry_point=f"{backends}:asynchronous",
            summary="Steps environments in place, in threads or on an event loop, as each asks for.",
        ),
        VectorBackendSpec(
            name="process",
            entry_point=f"{backends}:processes",
            summary="Steps environments in worker processes, which can be killed.",
        ),
    ]


@hookimpl
def gem_register_agents() -> Iterable[AgentSpec]:
    """Agents that need no model."""
    return [
        AgentSpec(
            name="random",
            entry_point="gem_core.agents.random:RandomAgent",
            summary="Draws a valid action in every state.",
        ),
        AgentSpec(
            name="human",
            entry_point="gem_core.agents.human:HumanAgent",
            summary="Asks a person at the terminal.",
        ),
    ]


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The subcommands of ``gem``, each in a module of its own that is imported when it is called."""
    summaries = {
        "list": "List the environments that can be made.",
        "info": "Describe one environment, tool, wrapper, agent or backend.",
        "play": "Play an environment yourself, in the terminal.",
        "run": "Let an agent act in environments and record its episodes.",
        "plugins": "List the installed plugins, and what is wrong with them.",
        "doctor": "Find out what is broken, and what is missing to run the rest.",
        "new-plugin": "Start a plugin that installs and passes its own tests.",
        "completion": "Print the script that completes words in your shell.",
    }
    return [
        CommandSpec(
            name=name,
            entry_point=f"gem_core.cli.{name.replace('-', '_')}_command:command",
            summary=summary,
        )
        for name, summary in summaries.items()
    ]
