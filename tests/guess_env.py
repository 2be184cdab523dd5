"""A well-behaved environment for the tests of the contract, and one that offers little."""

from __future__ import annotations

from typing import Any

import gem_core as gem


class GuessEnv(gem.Env):
    """Guess a number; a good citizen in every respect."""

    metadata = {"render_modes": ["ansi"], "render_fps": 1}  # noqa: RUF012 - as in Gymnasium

    def __init__(self, high: int = 9, *, turns: int = 5) -> None:
        super().__init__()
        self.high, self.turns = high, turns
        self.secret, self.turn = 0, 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.secret, self.turn = int(self.np_random.integers(1, self.high + 1)), 0
        return f"Guess a number from 1 to {self.high}.", {}

    def step(self, action: str) -> Any:
        self.turn += 1
        right = action == str(self.secret)
        mood = int(self.np_random.integers(0, 100))
        return f"{mood}", float(right), right or self.turn == self.turns, False, {"correct": right}

    def sample_random_action(self) -> str:
        return str(int(self.action_random.integers(1, self.high + 1)))

    def render(self) -> Any:
        return f"turn {self.turn}"


class StatelessEnv(gem.Env):
    """Saves no state and says nothing of valid actions."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        return "", {}


def play(env: Any, turns: int = 3) -> list[Any]:
    """Take the same few steps and return what came back."""
    return [env.step("0") for _ in range(turns)]
