"""Claims names that are the core's, and offers a tool of its own."""

from gem_core import AgentSpec, CommandSpec, ToolSpec, VectorBackendSpec, hookimpl


@hookimpl
def gem_register_tools():
    """Offer two tools, one with the name of a wrapper of the core's."""
    return [
        ToolSpec(name="latest", entry_point="gem_takes_core:latest"),
        ToolSpec(name="own_tool", entry_point="gem_takes_core:latest"),
    ]


@hookimpl
def gem_register_agents():
    """Offer an agent of the core's name."""
    return [AgentSpec(name="random", entry_point="gem_takes_core:latest")]


@hookimpl
def gem_register_vector_backends():
    """Offer a backend of the core's name."""
    return [VectorBackendSpec(name="sync", entry_point="gem_takes_core:latest")]


@hookimpl
def gem_add_commands():
    """Offer a command of the core's name."""
    return [CommandSpec(name="list", entry_point="gem_takes_core:latest")]


def latest(*arguments):
    """Do what nobody asked for."""
    raise RuntimeError("the plugin's was taken")
