"""Batches of tokens made from recorded episodes: what a loss takes."""

from __future__ import annotations

from gem_train.tokens.completions import Completion, completions
from gem_train.tokens.from_episodes import batches
from gem_train.tokens.token_batch import TokenBatch

__all__ = ["Completion", "TokenBatch", "batches", "completions"]
