"""A plugin that uses all eight hooks."""

from gem_core import (
    AgentSpec,
    CallFormatSpec,
    CommandSpec,
    EnvSpec,
    RequirementSpec,
    RequirementStatus,
    ToolSpec,
    VectorBackendSpec,
    WrapperSpec,
    hookimpl,
)


@hookimpl
def gem_register_envs():
    """Offer one environment, as a generator."""
    yield EnvSpec(id="fine:One-v0", entry_point="gem_fine_env:FineEnv", summary="Any answer is right.")


@hookimpl
def gem_register_tools():
    """Offer one tool."""
    return [ToolSpec(name="fine_tool", entry_point="gem_fine_tool:FineTool")]


@hookimpl
def gem_register_call_formats():
    """Offer one form of calls."""
    return [CallFormatSpec(name="fine_call", opening="<fine>", entry_point="gem_fine_tool:read_call")]


@hookimpl
def gem_register_wrappers():
    """Offer one wrapper."""
    return (WrapperSpec(name="fine_wrapper", entry_point="gem_fine_env:Shout"),)


@hookimpl
def gem_register_vector_backends():
    """Offer one backend."""
    return [VectorBackendSpec(name="fine_backend", entry_point="gem_fine_env:FineVectorEnv")]


@hookimpl
def gem_register_agents():
    """Offer one agent."""
    return [AgentSpec(name="fine_agent", entry_point="gem_fine_env:FineAgent")]


@hookimpl
def gem_register_requirements():
    """Offer one word."""
    return [RequirementSpec(name="fine_weather", entry_point="gem_fine:weather")]


@hookimpl
def gem_add_commands():
    """Offer one command."""
    return [CommandSpec(name="fine", entry_point="gem_fine_env:command")]


def weather(argument, *, closely=False):
    """Say what the weather is like."""
    return RequirementStatus("met", "the sun shines")
