"""The interval of a mean over a few seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import fmean, stdev
from typing import NamedTuple


class Interval(NamedTuple):
    """A mean with its 95 % confidence interval.

    Args:
        mean: The mean; NaN of no values.
        low: Lower end of the interval; None where there are fewer than two values, which tell nothing of the spread.
        high: Upper end.
    """

    mean: float
    low: float | None
    high: float | None


def mean_interval(values: Sequence[float]) -> Interval:
    """Return the mean of independent values, such as one a seed, with its 95 % interval by Student's t.

    The interval is ``mean ± t(0.975, n - 1) · s / √n`` with the sample's deviation ``s``. It takes the values as drawn
    from a normal distribution, which for five seeds cannot be checked.
    """
    if not values:
        return Interval(math.nan, None, None)
    mean = fmean(values)
    if len(values) < 2:
        return Interval(mean, None, None)
    half = t_quantile(0.975, len(values) - 1) * stdev(values) / math.sqrt(len(values))
    return Interval(mean, mean - half, mean + half)


def t_quantile(probability: float, degrees: int) -> float:
    """Return the quantile of Student's t distribution for a whole number of degrees of freedom.

    Args:
        probability: Between 0.5 and 1.
        degrees: Degrees of freedom, at least 1.

    The distribution has a closed form in the angle ``atan(t / √degrees)`` (Abramowitz and Stegun, 26.7.3 and 26.7.4),
    which is searched by halving.
    """
    low, high = 0.0, math.pi / 2
    for _ in range(60):
        middle = (low + high) / 2
        if 0.5 + _central_mass(middle, degrees) / 2 < probability:
            low = middle
        else:
            high = middle
    return math.sqrt(degrees) * math.tan(high)


def _central_mass(angle: float, degrees: int) -> float:
    """Return P(|T| < t) for the t with this angle."""
    odd = degrees % 2
    term = math.cos(angle) if odd else 1.0
    total = term if degrees > 1 else 0.0
    for k in range(2 + odd, degrees, 2):
        term *= (k - 1) / k * math.cos(angle) ** 2
        total += term
    mass = math.sin(angle) * total
    return 2 / math.pi * (angle + mass) if odd else mass
