"""What the files in ``examples/trainers`` share: an agent over token engines, and environments as chats."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_train.adapters.batched_engine import BatchedEngine
    from gem_train.adapters.chat_session import ChatSession, ChatStep
    from gem_train.adapters.chat_template import ChatTemplate
    from gem_train.adapters.image_urls import images_as_urls
    from gem_train.adapters.token_agent import Generated, TokenAgent
    from gem_train.adapters.trial import TrialEngine, trial_tokenizer

__all__ = [
    "BatchedEngine",
    "ChatSession",
    "ChatStep",
    "ChatTemplate",
    "Generated",
    "TokenAgent",
    "TrialEngine",
    "images_as_urls",
    "trial_tokenizer",
]

_HOME = {
    "BatchedEngine": "batched_engine",
    "ChatSession": "chat_session",
    "ChatStep": "chat_session",
    "ChatTemplate": "chat_template",
    "Generated": "token_agent",
    "TokenAgent": "token_agent",
    "TrialEngine": "trial",
    "images_as_urls": "image_urls",
    "trial_tokenizer": "trial",
}
"""Where the public names come from; they are imported on first use."""


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
