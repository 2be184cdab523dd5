"""What several runs of a setting measured, as means with intervals over seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gem_core.errors import EnvFaultError
from gem_train.learner.playing import Played
from gem_train.learner.training import Training
from gem_train.reporting import Curve, Interval, mean_interval

Run = Mapping[str, Any]
"""The result of a job."""


def evaluated(training: Training, env_id: str | None = None) -> list[Played]:
    """Return the episodes of an evaluation, those with an error left out.

    Raises:
        EnvFaultError: All of them had one.
    """
    played = [seat for seat in training.evaluate(env_id) if not seat.error]
    if not played:
        raise EnvFaultError(f"every episode of {env_id or training.options.env[0]} had an error; try 'gem run' on it")
    return played


def last_interval(runs: Sequence[Run], value: Callable[[Any], float]) -> Interval:
    """Return the mean of a value after the last update, with its interval.

    Args:
        runs: One a seed.
        value: Reads it from what ``measure`` returned.
    """
    return mean_interval([value(run["measured"][-1]) for run in runs])


def measured_curve(runs: Sequence[Run], value: Callable[[Any], float]) -> Curve:
    """Return a value over the updates at which it was measured, with its band.

    Args:
        runs: One a seed.
        value: Reads it from what ``measure`` returned.
    """
    steps = [run["update"] for run in runs[0]["measured"]]
    return curve(steps, [[value(each) for each in run["measured"]] for run in runs])


def curve(steps: Sequence[int], values: Sequence[Sequence[float]]) -> Curve:
    """Return the mean of several runs, (runs, steps), with its interval at each step."""
    intervals = [mean_interval(of_step) for of_step in zip(*values, strict=True)]
    return Curve(list(steps), *([getattr(each, end) for each in intervals] for end in ("mean", "low", "high")))
