"""Records of the core's own wrappers, backends, agents and commands, by the same hooks as those of plugins."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry.hookspecs import hookimpl
from gem_core.registry.specs import AgentSpec, CommandSpec, VectorBackendSpec, WrapperSpec

_WRAPPERS = {
    "latest": ("views:Latest", "Show only the newest output."),
    "concat": ("views:Concat", "Show all outputs so far."),
    "concat_with_action": ("views:ConcatWithAction", "Show all outputs and actions so far."),
    "messages": ("chat:MessagesView", "Show the history as a list of chat messages."),
    "concat_chat": ("chat:ConcatChat", "Show the history as the text of a tokenizer's chat template."),
    "episode_stats": (
        "episode_stats:EpisodeStats",
        "Report return, length and duration in info['episode'] at the end.",
    ),
    "turn_limit": ("turn_limit:TurnLimit", "Truncate an episode after max_turns turns."),
}
_BACKENDS = {
    "auto": ("auto", "Chooses by what each environment says of itself."),
    "sync": ("sync", "Steps one environment after another, in this thread."),
    "async": ("asynchronous", "Steps environments in place, in threads or on an event loop, as each asks for."),
    "process": ("processes", "Steps environments in worker processes, which can be killed."),
}
_COMMANDS = {
    "list": "List the environments that can be made.",
    "info": "Describe one environment, tool, wrapper, agent or backend.",
    "play": "Play an environment yourself, in the terminal.",
    "run": "Let an agent act in environments and record its episodes.",
    "plugins": "List the installed plugins, and what is wrong with them.",
    "doctor": "Find out what is broken, and what is missing to run the rest.",
    "new-plugin": "Start a plugin that installs and passes its own tests.",
}


@hookimpl
def gem_register_wrappers() -> Iterable[WrapperSpec]:
    """Observation views, statistics and limits."""
    yield WrapperSpec(
        name="tools", entry_point="gem_core.tools.env:ToolEnv", summary="Offer several tools, with rewards and limits."
    )
    for name, (place, summary) in _WRAPPERS.items():
        yield WrapperSpec(name=name, entry_point=f"gem_core.wrappers.{place}", summary=summary)


@hookimpl
def gem_register_vector_backends() -> Iterable[VectorBackendSpec]:
    """The backends that need nothing but the core."""
    for name, (function, summary) in _BACKENDS.items():
        yield VectorBackendSpec(name=name, entry_point=f"gem_core.vector.backends:{function}", summary=summary)


@hookimpl
def gem_register_agents() -> Iterable[AgentSpec]:
    """Agents that need no model."""
    yield AgentSpec(
        name="random", entry_point="gem_core.agents.random:RandomAgent", summary="Draws a valid action in every state."
    )
    yield AgentSpec(
        name="human", entry_point="gem_core.agents.human:HumanAgent", summary="Asks a person at the terminal."
    )


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The subcommands of ``gem``, each in a module of its own that is imported when it is called."""
    for name, summary in _COMMANDS.items():
        module = f"gem_core.cli.{name.replace('-', '_')}_command"
        yield CommandSpec(name=name, entry_point=f"{module}:command", summary=summary)
