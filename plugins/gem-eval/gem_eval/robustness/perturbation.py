"""``Perturbation``: the base class of wrappers that disturb an agent at random, by the seed of the episode."""

from __future__ import annotations

from typing import Any

from gem_core.env import AnyEnv, Wrapper, stable_hash
from gem_core.errors import ArgumentError
from gem_core.types import ResetResult

_HASHES = 1 << 53
"""``stable_hash`` returns whole numbers below this."""


class Perturbation(Wrapper):
    """Draws from the episode's seed, the name of its class and a counter, and from nothing of the task.

    So the same seed and actions give the same perturbations, and the task goes on as it would have without them.

    Args:
        env: What is disturbed.
        rate: Probability that it is, each time, from 0 to 1.

    Raises:
        ArgumentError: The rate is no such number.
    """

    def __init__(self, env: AnyEnv, rate: float) -> None:
        super().__init__(env)
        if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 <= rate <= 1:
            raise ArgumentError(f"rate must be a number from 0 to 1, not {rate!r}")
        self.rate = float(rate)
        self._seed = self._draws = 0

    def before_reset(self, seed: int | None, options: dict[str, Any] | None) -> None:
        """Begin to count anew."""
        self._draws = 0

    def after_reset(self, result: ResetResult) -> ResetResult:
        """Remember the seed of the episode."""
        self._seed = self.unwrapped.np_random_seed
        return result

    def below(self, limit: int) -> int:
        """Draw a whole number from 0 to ``limit`` - 1."""
        self._draws += 1
        return stable_hash(self._seed, type(self).__name__, self._draws) % limit

    def happens(self) -> bool:
        """Draw whether the agent is disturbed this time."""
        self._draws += 1
        return stable_hash(self._seed, type(self).__name__, self._draws) < self.rate * _HASHES
