"""A limit of turns set from outside the task."""

from __future__ import annotations

from typing import Any

from gem_core.env.checks import reset_needed
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.errors import ArgumentError
from gem_core.types import StepResult


class TurnLimit(Wrapper):
    """Truncates an episode after ``max_turns`` turns, unless the task ends by itself at that turn.

    Args:
        env: What is limited.
        max_turns: Number of steps allowed, from 1 up.
    """

    def __init__(self, env: AnyEnv, max_turns: int) -> None:
        super().__init__(env)
        if type(max_turns) is not int or max_turns < 1:
            raise ArgumentError(f"max_turns must be a positive whole number, not {max_turns!r}")
        self.max_turns = max_turns
        self.turn = 0

    def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> None:
        """Reset the counter."""
        self.turn = 0

    def before_step(self, action: str) -> str:
        """Refuse a step after the limit, as ``make``'s own guard does after the end of the task."""
        if self.turn >= self.max_turns:
            raise reset_needed(self)
        return action

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Truncate at the limit."""
        self.turn += 1
        observation, reward, terminated, truncated, info = result
        return observation, reward, terminated, truncated or (self.turn >= self.max_turns and not terminated), info
