"""``Perturbation``: the base class of wrappers that disturb an agent at random, by the seed of the episode."""

from __future__ import annotations

from typing import Any

from gem_core.env import AnyEnv, Wrapper, stable_hash
from gem_core.errors import ArgumentError
from gem_core.tools import ToolEnv, find_tool_env
from gem_core.types import ResetResult

_HASHES = 1 << 53
"""``stable_hash`` returns whole numbers below this."""


class NoToolsError(ArgumentError):
    """A wrapper changes tools, and there are none inside it."""


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
        self.rate = share(rate, "rate")
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
        return drawn(self.rate, self._seed, type(self).__name__, self._draws)


def drawn(rate: float, *what: int | str | None) -> bool:
    """Draw from a hash of some values whether something happens that has a probability."""
    return stable_hash(*what) < rate * _HASHES


def share(value: object, name: str) -> float:
    """Return an option that is a share.

    Raises:
        ArgumentError: It is no number from 0 to 1.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
        raise ArgumentError(f"{name} must be a number from 0 to 1, not {value!r}")
    return float(value)


def tool_env_in(env: AnyEnv, wanted_by: str) -> ToolEnv:
    """Return the wrapper that gives tools to a task.

    Args:
        env: The environment around which a wrapper is put.
        wanted_by: Name of that wrapper's class, for the error.

    Raises:
        NoToolsError: There is none.
    """
    found = find_tool_env(env)
    if found is None:
        name = env.unwrapped.spec.id if env.unwrapped.spec is not None else type(env.unwrapped).__name__
        raise NoToolsError(
            f"{wanted_by} changes tools that wrappers offer, and there are none inside it around {name}; "
            "name tools before it, as in 'python,tool_429'"
        )
    return found
