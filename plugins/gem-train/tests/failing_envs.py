"""Environments and a tool that fail in each way that an adapter has to tell apart."""

from __future__ import annotations

from typing import Any

import pydantic

import gem_core as gem


class ThreeTurns(gem.Env):
    """Pays the number of the turn, three times; the machinery fails in the turn, or in the reset, that it is told."""

    def __init__(self, fails_in_turn: int | None = None, fails_in_reset: bool = False) -> None:
        super().__init__()
        self.fails_in_turn, self.fails_in_reset, self.turn = fails_in_turn, fails_in_reset, 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        if self.fails_in_reset:
            raise ConnectionError("no server")
        self.turn = 0
        return f"Task {self.np_random.integers(1000)}.", {"system": "Be brief."}

    def step(self, action: str) -> Any:
        self.turn += 1
        if self.turn == self.fails_in_turn:
            raise ConnectionError("the server is gone")
        over = self.turn == 3
        return f"Turn {self.turn}.", float(self.turn), over, False, {"correct": True} if over else {}


class Divide(gem.Tool):
    """Divides."""

    name = "divide"
    description = "Divides two numbers."
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """Two numbers."""

        left: int = pydantic.Field(description="What is divided.")
        right: int = pydantic.Field(1, description="By what; 1 by default.")

    def call(self, arguments: Any, session: Any) -> str:
        if arguments.right == 0:
            raise ValueError("division by zero")
        return f"{arguments.left / arguments.right:g}"


def register(name: str, **kwargs: Any) -> str:
    """Register ``ThreeTurns`` with arguments, once; return its id."""
    env_id = f"failing:{name}-v0"
    if env_id not in gem.list_envs("failing"):
        gem.register(env_id, ThreeTurns, **kwargs)
    return env_id
