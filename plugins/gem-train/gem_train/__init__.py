"""Train agents: estimators, token batches, a small learner, and adapters to trainers; see ``docs/training.md``."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_train.adapters import ChatSession, TokenAgent
    from gem_train.learner.options import TrainOptions
    from gem_train.learner.run import train
    from gem_train.tokens import TokenBatch, batches

__all__ = ["ChatSession", "TokenAgent", "TokenBatch", "TrainOptions", "batches", "train"]

_HOME = {
    "ChatSession": "adapters",
    "TokenAgent": "adapters",
    "TokenBatch": "tokens",
    "TrainOptions": "learner.options",
    "batches": "tokens",
    "train": "learner.run",
}
"""Where the public names come from; they are imported on first use."""


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
