"""The interval of a mean over a few seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple


class Interval(NamedTuple):
    """A mean with its 95 % confidence interval.

    Args:
        mean: The mean; NaN of no values.
        low: Lower end of the interval; None for fewer than two values, which tell nothing of the spread.
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
    from scipy.stats import ttest_1samp  # type: ignore[import-untyped]

    mean = fmean(values) if values else math.nan
    if len(values) < 2:
        return Interval(mean, None, None)
    low, high = ttest_1samp(values, mean).confidence_interval()
    return Interval(mean, float(low), float(high))
