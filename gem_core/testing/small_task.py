"""``SmallTask``: the environment with which wrappers, agents and vector backends are checked."""

from __future__ import annotations

from typing import Any

from gem_core.api import register
from gem_core.env.base import Env
from gem_core.env.observations import observation_from
from gem_core.types import ResetResult, StepResult

SMALL_TASK = "check:Small-v0"


def register_small_task() -> None:
    """Register the small task."""
    register(SMALL_TASK, f"{__name__}:SmallTask", summary="Three turns; made for checks.")


class SmallTask(Env):
    """Three turns; a number stands on the board, and naming it earns a reward. ``"break"`` makes a step raise."""

    answer = "what earlier wrappers must not hide"

    def __init__(self) -> None:
        super().__init__()
        self._number = self._turn = 0

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Draw the first number."""
        super().reset(seed=seed)
        self._turn = 0
        return self._observed("Say the number.\n")

    def step(self, action: str) -> StepResult:
        """Compare, and draw the next."""
        if action == "break":
            raise RuntimeError("broken on request")
        right = action == f"say {self._number}"
        self._turn += 1
        observation, info = self._observed("Right.\n" if right else "Wrong.\n")
        over = self._turn == 3
        if over:
            info["correct"] = right
        return observation, float(right), over, False, info

    def sample_random_action(self) -> str:
        """Say some number."""
        return f"say {int(self.action_random.integers(10))}"

    def _observed(self, feedback: str) -> ResetResult:
        self._number = int(self.np_random.integers(10))
        suffix = f"The number is {self._number}. Turn {self._turn + 1} of 3."
        return observation_from(feedback, suffix), {"feedback": feedback, "suffix": suffix}
