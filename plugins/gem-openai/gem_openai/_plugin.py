"""What this distribution offers; it imports no HTTP library."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import AgentSpec, hookimpl


@hookimpl
def gem_register_agents() -> Iterable[AgentSpec]:
    """The agent ``openai``."""
    return [
        AgentSpec(
            name="openai",
            entry_point="gem_openai:OpenAIAgent",
            summary="Asks a model behind an OpenAI-compatible server, as openai:MODEL.",
        )
    ]
