"""Records of the core's own wrappers, backends, agents and commands, by the same hooks as those of plugins."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry.hookspecs import hookimpl
from gem_core.registry.specs import AgentSpec, CommandSpec, VectorBackendSpec, WrapperSpec

_WRAPPERS = [
    ("latest", "wrappers.views:Latest", "Show only the newest output."),
    ("concat", "wrappers.views:Concat", "Show all outputs so far."),
    ("concat_with_action", "wrappers.views:ConcatWithAction", "Show all outputs and actions so far."),
    ("messages", "wrappers.chat:MessagesView", "Show the history as a list of chat messages."),
    ("concat_chat", "wrappers.chat:ConcatChat", "Show the history as the text of a tokenizer's chat template."),
    (
        "episode_stats",
        "wrappers.episode_stats:EpisodeStats",
        "Report return, length and duration in info['episode'] at the end.",
    ),
    ("turn_limit", "wrappers.turn_limit:TurnLimit", "Truncate an episode after max_turns turns."),
    ("tools", "tools.env:ToolEnv", "Offer several tools, with rewards and limits."),
]
_BACKENDS = [
    ("auto", "vector.backends:auto", "Chooses by what each environment says of itself."),
    ("sync", "vector.backends:sync", "Steps one environment after another, in this thread."),
    (
        "async",
        "vector.backends:asynchronous",
        "Steps environments in place, in threads or on an event loop, as each asks for.",
    ),
    ("process", "vector.backends:processes", "Steps environments in worker processes, which can be killed."),
]
_AGENTS = [
    ("random", "agents.random:RandomAgent", "Draws a valid action in every state."),
    ("human", "agents.human:HumanAgent", "Asks a person at the terminal."),
]
_COMMANDS = {
    "list": "List the environments that can be made.",
    "info": "Describe one environment, tool, wrapper, agent or backend.",
    "play": "Play an environment yourself, in the terminal.",
    "run": "Let an agent act in environments and record its episodes.",
    "plugins": "List the installed plugins, and what is wrong with them.",
    "doctor": "Find out what is broken, and what is missing to run the rest.",
    "new-plugin": "Start a plugin that installs and passes its own tests.",
    "completion": "Print the script that completes words in your shell.",
}


@hookimpl
def gem_register_wrappers() -> Iterable[WrapperSpec]:
    """Observation views, statistics and limits."""
    return [WrapperSpec(name=name, entry_point=f"gem_core.{at}", summary=text) for name, at, text in _WRAPPERS]


@hookimpl
def gem_register_vector_backends() -> Iterable[VectorBackendSpec]:
    """The backends that need nothing but the core."""
    return [VectorBackendSpec(name=name, entry_point=f"gem_core.{at}", summary=text) for name, at, text in _BACKENDS]


@hookimpl
def gem_register_agents() -> Iterable[AgentSpec]:
    """Agents that need no model."""
    return [AgentSpec(name=name, entry_point=f"gem_core.{at}", summary=text) for name, at, text in _AGENTS]


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The subcommands of ``gem``, each in a module of its own that is imported when it is called."""
    return [
        CommandSpec(name=name, entry_point=f"gem_core.cli.{name.replace('-', '_')}_command:command", summary=text)
        for name, text in _COMMANDS.items()
    ]
