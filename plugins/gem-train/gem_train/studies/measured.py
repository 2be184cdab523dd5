"""What several runs of a setting measured, as means with intervals over seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gem_train.reporting import Curve, Interval, mean_interval

Run = Mapping[str, Any]
"""The result of a job."""


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
    places = range(len(runs[0]["measured"]))
    intervals = [mean_interval([value(run["measured"][place]) for run in runs]) for place in places]
    steps = [run["update"] for run in runs[0]["measured"]]
    if len(runs) < 2:
        return Curve(steps, [interval.mean for interval in intervals])
    return Curve(steps, *([getattr(interval, end) for interval in intervals] for end in ("mean", "low", "high")))
