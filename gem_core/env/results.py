"""Checks of what ``reset`` and ``step`` return, and of actions."""

from __future__ import annotations

import math
from typing import Any, NoReturn

import numpy as np

from gem_core.errors import ArgumentError
from gem_core.types import ResetResult, StepResult

_OBSERVATIONS = (str, list)
_TEXTS = (str, bytes)
_FLAGS = (bool, np.bool_, int, np.integer)


def checked_result(result: object) -> StepResult:
    """Return a step's result if it is one.

    Raises:
        TypeError: It is not five values, or a value has a wrong type.
        ValueError: The reward is not finite.

    The info is copied: what the environment does with its own dictionary later changes nothing that was recorded.
    """
    if not isinstance(result, tuple) or len(result) != 5:
        raise TypeError(f"step must return (observation, reward, terminated, truncated, info), not {result!r:.200}")
    observation, reward, terminated, truncated, info = result
    number = checked_reward(reward)
    _check_types(observation, info)
    for name, flag in (("terminated", terminated), ("truncated", truncated)):
        if type(flag) is not bool and not (isinstance(flag, _FLAGS) and flag in (0, 1)):
            raise TypeError(f"{name} must be True or False, not {flag!r:.200}")  # any object would count as one of them
    return observation, number, bool(terminated), bool(truncated), info.copy()


def checked_reward(reward: Any, whose: str = "the reward") -> float:
    """Return a reward as a number.

    Raises:
        TypeError: It is none.
        ValueError: It is not finite.
    """
    try:
        number = math.nan if isinstance(reward, _TEXTS) else float(reward)
    except (TypeError, ValueError, OverflowError) as error:
        raise TypeError(f"{whose} must be a finite number, not {reward!r:.200}") from error
    if not math.isfinite(number):
        raise ValueError(f"{whose} must be a finite number, not {reward!r:.200}")
    return number


def checked_reset(result: object) -> ResetResult:
    """Return a reset's result if it is one, its info copied as by ``checked_result``.

    Raises:
        TypeError: It is not two values, or a value has a wrong type.
    """
    if not isinstance(result, tuple) or len(result) != 2:
        raise TypeError(f"reset must return (observation, info), not {result!r:.200}")
    observation, info = result
    _check_types(observation, info)
    return observation, info.copy()


def refuse_action(action: object) -> NoReturn:
    """Raise the error of an action that is no text.

    Raises:
        ArgumentError: Always.
    """
    raise ArgumentError(f"an action is a str or a Response, not {action!r:.100} of type {type(action).__name__}")


def _check_types(observation: object, info: object) -> None:
    if not isinstance(observation, _OBSERVATIONS):
        raise TypeError(f"an observation must be text or a list, not {type(observation).__name__}")
    if not isinstance(info, dict):
        raise TypeError(f"info must be a dictionary, not {type(info).__name__}")
