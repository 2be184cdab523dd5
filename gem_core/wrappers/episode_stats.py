"""Return, length and duration of each episode."""

from __future__ import annotations

import time
from typing import Any

from gem_core.env.wrapper import AnyEnv, Wrapper
from gem_core.types import StepResult


class EpisodeStats(Wrapper):
    """Puts ``info["episode"] = {"r": return, "l": turns, "t": seconds}`` on the last step of an episode.

    Args:
        env: What is measured.

    Source: keys and meaning of Gymnasium's ``RecordEpisodeStatistics``.
    """

    def __init__(self, env: AnyEnv) -> None:
        super().__init__(env)
        self._return = 0.0
        self._length = 0
        self._started = time.perf_counter()

    def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> None:
        """Reset the counters."""
        self._return, self._length = 0.0, 0
        self._started = time.perf_counter()

    def after_step(self, action: str, result: StepResult) -> StepResult:
        """Add the turn, and report at the end."""
        _, reward, terminated, truncated, info = result
        self._return += float(reward)
        self._length += 1
        if terminated or truncated:
            seconds = round(time.perf_counter() - self._started, 6)
            info["episode"] = {"r": self._return, "l": self._length, "t": seconds}
        return result
