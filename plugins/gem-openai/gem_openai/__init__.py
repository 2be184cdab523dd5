"""The agent for models behind OpenAI-compatible servers: a plugin of GEM."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_openai.agent import OpenAIAgent

__all__ = ["OpenAIAgent"]


def __getattr__(name: str) -> Any:
    # Resolved on first use: listing the agents imports this package and must not load an HTTP library.
    if name == "OpenAIAgent":
        from gem_openai.agent import OpenAIAgent

        return OpenAIAgent
    raise AttributeError(f"module 'gem_openai' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
