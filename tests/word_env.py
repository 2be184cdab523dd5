"""Small environments for the tests of the registry, and its errors in one line."""

from __future__ import annotations

from typing import Any

import pytest

import gem_core as gem
from gem_core import errors


class WordEnv(gem.Env):
    """Asks for a word."""

    def __init__(self, word: str = "gem", *, tries: int = 3) -> None:
        super().__init__()
        self.word, self.tries = word, tries

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        return "Which word?", {}

    def step(self, action: str) -> Any:
        return gem.TERMINAL_STATE, float(action == self.word), True, False, {}


class PlainEnv(gem.Env):
    """Has no constructor of its own."""


def message(call: Any, *args: Any, **kwargs: Any) -> str:
    """Return the error of a call in one line."""
    with pytest.raises(errors.GemError) as caught:
        call(*args, **kwargs)
    return f"{type(caught.value).__name__}: {caught.value}"
