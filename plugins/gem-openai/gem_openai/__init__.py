"""Models behind OpenAI-compatible servers, as agents and as judges: a plugin of GEM."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_openai.agent import OpenAIAgent
    from gem_openai.judge import ModelJudge

__all__ = ["ModelJudge", "OpenAIAgent"]

_HOME = {"ModelJudge": "gem_openai.judge", "OpenAIAgent": "gem_openai.agent"}


def __getattr__(name: str) -> Any:
    # Resolved on first use: listing the agents imports this package and must not load an HTTP library.
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'gem_openai' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
