"""Mean and paired difference over rows with their intervals, in one place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist, fmean, stdev
from typing import NamedTuple

Rows = Sequence[Sequence[float]]
"""Values by row: one inner sequence for each row, with a value for each epoch."""

_Z = NormalDist().inv_cdf(0.975)


class Estimate(NamedTuple):
    """A mean with its standard error, clustered by row, and a 95 % interval; None where the sample does not tell."""

    mean: float
    stderr: float | None
    low: float | None
    high: float | None


def mean(rows: Rows) -> Estimate:
    """Estimate the mean of values, by row."""
    means = [fmean(row) for row in rows]
    center = fmean(means)
    if len(means) < 2:
        return Estimate(center, None, None, None)
    stderr = stdev(means) / math.sqrt(len(means))
    return Estimate(center, stderr, center - _Z * stderr, center + _Z * stderr)


def paired_difference(a: Rows, b: Rows) -> Estimate:
    """Estimate the mean of ``a - b`` over the same rows in the same order."""
    return mean([[fmean(one) - fmean(other)] for one, other in zip(a, b, strict=True)])
