"""``Guard``: the wrapper around every task that ``make`` returns, which reports mistakes of the task as errors."""

from __future__ import annotations

from typing import Any

from gem_core.env.checks import checked_reset, checked_result, refuse_action, reset_needed
from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.types import ResetResult, StepResult


class Guard(Wrapper):
    """Refuses steps outside an episode and malformed results, and reports seeds; ``make`` puts it innermost."""

    hidden_in_spec = True
    checks_results = True
    """Whether malformed results are refused; ``check_env`` turns it off and checks them itself."""
    _live = False
    _plain_only = False  # its step is its two hooks in one function, since every step of every task passes it

    def __init__(self, env: AnyEnv) -> None:
        super().__init__(env)
        self._whose = f"{type(env.unwrapped).__name__}: "

    def step(self, action: str) -> StepResult:
        """Step, if the episode is under way."""
        if not self._live:
            raise reset_needed(self)
        if not isinstance(action, str):
            refuse_action(action)
        result: Any = self.env.step(action)
        if self.checks_results:
            result = checked_result(result, self._whose)
        self._live = not (result[2] or result[3])
        return result  # type: ignore[no-any-return]

    def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> None:
        """Refuse steps until the reset has succeeded."""
        self._live = False

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Refuse a malformed result, and write the episode's seed to ``info``."""
        if self.checks_results:
            result = checked_reset(result, self._whose)
        result[1]["seed"] = self.env.np_random_seed
        self._live = True
        return result

    def before_step(self, action: str) -> str:
        """Refuse a step outside an episode."""
        if not self._live:
            raise reset_needed(self)
        return action

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Refuse a malformed result, and record the end of the episode."""
        if self.checks_results:
            result = checked_result(result, self._whose)
        self._live = not (result[2] or result[3])
        return result
