"""What the files in ``examples/trainers`` share: an agent over token engines, and environments as chats."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_train.adapters.chat_session import ChatSession, ChatStep
    from gem_train.adapters.token_agent import Generated, TokenAgent

__all__ = ["ChatSession", "ChatStep", "Generated", "TokenAgent"]

_HOME = {
    "ChatSession": "chat_session",
    "ChatStep": "chat_session",
    "Generated": "token_agent",
    "TokenAgent": "token_agent",
}
"""Where the public names come from; they are imported on first use."""


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
