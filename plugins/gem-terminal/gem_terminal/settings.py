"""``Settings``: the keywords of ``TerminalEnv``, checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

from gem_core.errors import ArgumentError
from gem_terminal.verifying.verdict import RewardRule
from gem_terminal.verifying.verify import Where

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Limits

_MOST_SECONDS = 10 * 365 * 86_400.0


@dataclass(frozen=True)
class Settings:
    """How episodes run; what each means is told in ``TerminalEnv``."""

    reward: RewardRule
    weights: Mapping[str, float] | None
    command_timeout_s: float
    most_command_timeout_s: float
    agent_timeout_s: float | Literal["task"] | None
    episode_timeout_s: float | None
    max_turns: int | None
    malformed_penalty: float
    max_malformed: int | None
    max_output: int
    columns: int
    lines: int
    show_time: bool
    verify_in: Where
    artifacts: tuple[str, ...]
    pool_size: int
    limits: Limits

    @property
    def longest_command_s(self) -> float:
        """Seconds that a command may ask for."""
        return max(self.command_timeout_s, self.most_command_timeout_s)

    @property
    def return_range(self) -> tuple[float, float] | None:
        """The lowest and the highest return; None if a task's own reward file or the number of turns leaves it open."""
        penalty = self.malformed_penalty
        if self.reward != "all" or (penalty and self.max_turns is None):
            return None
        of_malformed = penalty * (self.max_turns or 0)
        return min(0.0, of_malformed), 1.0 + max(0.0, of_malformed)

    def __post_init__(self) -> None:
        values = vars(self) | vars(self.limits)
        for name, (fits, expected) in _CHECKS.items():
            if not fits(values[name]):
                raise ArgumentError(f"{name} must be {expected}, not {values[name]!r}")


_Check = tuple[Callable[[Any], bool], str]
"""Whether a value is accepted, and what is, in words."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_seconds(value: Any) -> bool:
    return _is_number(value) and 0 < value <= _MOST_SECONDS


def _are_paths(value: tuple[str, ...]) -> bool:
    return all(path.startswith("/") and path.strip("/") for path in value)


def _are_weights(value: Any) -> bool:
    return value is None or (
        isinstance(value, Mapping)
        and all(isinstance(name, str) and _is_number(weight) and weight >= 0 for name, weight in value.items())
    )


def _one_of(*names: str) -> _Check:
    return lambda value: value in names, f"one of {', '.join(map(repr, names))}"


def _count(expected: str, least: int, most: int = 2**40) -> _Check:
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and least <= value <= most, expected


def _or_none(check: _Check) -> _Check:
    return lambda value: value is None or check[0](value), check[1]


_SECONDS: _Check = (_is_seconds, "seconds above 0")
_CHECKS: dict[str, _Check] = {
    "reward": _one_of(*get_args(RewardRule)),
    "verify_in": _one_of(*get_args(Where)),
    "artifacts": (_are_paths, "absolute paths below /"),
    "weights": (_are_weights, "a mapping of names of tests to numbers from 0 up"),
    "command_timeout_s": _SECONDS,
    "most_command_timeout_s": _SECONDS,
    "agent_timeout_s": (lambda v: v in (None, "task") or _is_seconds(v), "seconds above 0, 'task' or None"),
    "episode_timeout_s": _or_none((_is_seconds, "seconds above 0 or None")),
    "max_turns": _or_none(_count("a whole number from 1 up, or None", 1)),
    "max_malformed": _or_none(_count("a whole number from 1 up, or None", 1)),
    "malformed_penalty": (_is_number, "a number"),
    "max_output": _count("a whole number of characters from 100 up", 100),
    "columns": _count("a whole number from 20 to 1000", 20, 1000),
    "lines": _count("a whole number from 5 to 1000", 5, 1000),
    "pool_size": _count("a whole number from 0 to 1000", 0, 1000),
    "cpus": _or_none((lambda v: _is_number(v) and v >= 0.01, "a number from 0.01 up, or None")),
    "memory_mb": _or_none(_count("whole megabytes from 16 up, or None", 16)),
    "processes": _count("a whole number from 16 up", 16),
    "storage_mb": _or_none(_count("whole megabytes from 1 up, or None", 1)),
    "network": _one_of("task", "none", "public"),
}
