"""``Guard``: the wrapper around every task that ``make`` returns, which reports mistakes of the task as errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from gem_core.env.results import checked_reset, checked_result, refuse_action
from gem_core.env.wrapper import Wrapper
from gem_core.errors import ResetNeededError
from gem_core.types import ResetResult, StepResult


class Guard(Wrapper):
    """Refuses steps outside an episode and malformed results, and reports seeds; ``make`` puts it innermost."""

    hidden_in_spec = True
    checks_results = True
    """Whether malformed results are refused; ``check_env`` turns it off and checks them itself."""
    _live = False
    _plain_only = False  # its step is its two hooks, without the way through coroutines

    def step(self, action: str) -> StepResult:
        """Step, if the episode is under way."""
        if not isinstance(action, str):
            refuse_action(action)
        return self.after_step(action, cast("StepResult", self.env.step(self.before_step(action))))

    def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> None:
        """Refuse steps until the reset has succeeded."""
        self._live = False

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Refuse a malformed result, and write the episode's seed to ``info``."""
        result = self._checked(checked_reset, result)
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
        result = self._checked(checked_result, result)
        self._live = not (result[2] or result[3])
        return result

    def _checked(self, check: Callable[[object], Any], result: Any) -> Any:
        if not self.checks_results:
            return result
        try:
            return check(result)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{type(self.unwrapped).__name__}: {error}") from None


def reset_needed(env: Wrapper) -> ResetNeededError:
    """Return the error of a step outside an episode."""
    name = env.env_id or type(env.unwrapped).__name__
    return ResetNeededError(f"{name}: the episode is over or has not begun; call reset() before the next step()")
