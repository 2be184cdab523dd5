"""Tools and an environment for the tests of perturbations."""

from __future__ import annotations

from typing import Any

import pydantic

import gem_core as gem
from gem_core.types import ResetResult, StepResult


class Notebook(gem.Tool):
    """Keeps the lines of an episode, so that it shows whether a call was executed."""

    name = "note"
    description = "Writes a line into the notebook and shows it all."
    fences = ("note",)
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """One line."""

        text: str
        times: int = 1

    def open(self) -> list[str]:
        return []

    def call(self, arguments: Any, session: list[str]) -> gem.ToolResult:
        session += [arguments.text] * arguments.times
        return gem.ToolResult("\n".join(session))


class SlowNotebook(Notebook):
    """The same as a coroutine."""

    async def call(self, arguments: Any, session: list[str]) -> gem.ToolResult:  # type: ignore[override]  # a coroutine is allowed in its place
        return Notebook.call(self, arguments, session)


class Dice(gem.Env):
    """Shows a new number each turn, drawn by the task, and ends after six turns; ``right`` is a solution."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        self.turn = 0
        return self._shown("Guess the number that is thrown. You cannot see it, for example 'seven'.\n")

    def step(self, action: str) -> StepResult:
        self.turn += 1
        observation, info = self._shown("That was a wonderful guess, and nothing else is known of it.\n")
        over = self.turn == 6 or action == "right"
        return observation, float(action == "right"), over, False, {**info, "correct": action == "right"}

    def sample_random_action(self) -> str:
        return "right" if self.action_random.integers(2) else "wrong"

    def _shown(self, feedback: str) -> ResetResult:
        suffix = f"Thrown: {int(self.np_random.integers(1000))}."
        return feedback + suffix, {"feedback": feedback, "suffix": suffix}


class Echo(gem.Env):
    """One turn; right is who says 'hello'."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        super().reset(seed=seed)
        return "Please say hello to everybody in the room.", {}

    def step(self, action: str) -> StepResult:
        return gem.TERMINAL_STATE, float(action == "hello"), True, False, {"correct": action == "hello"}


def register() -> None:
    """Register the environments."""
    gem.register("perturbed:Dice-v0", Dice)
    gem.register("perturbed:Echo-v0", Echo)
