"""Standard errors of scores: one rule for the tables of ``gem run`` and of plugins."""

from __future__ import annotations

import math
from collections.abc import Iterable

Range = tuple[float, float]
"""The lowest and the highest value that there can be."""


def wilson(share: float, size: float, normal: float = 1.0) -> tuple[float, float]:
    """Return the middle of Wilson's score interval and half its width.

    Args:
        share: The mean, from 0 to 1.
        size: Number of independent observations.
        normal: Quantile of the normal distribution; 1 for one standard error.

    Source: E. B. Wilson, JASA 22 (1927), 209-212.
    """
    weight = 1 + normal**2 / size
    half = normal * math.sqrt(share * (1 - share) / size + (normal / size / 2) ** 2) / weight
    return (share + normal**2 / size / 2) / weight, half


def effective_size(rows: int, share: float, squares: float) -> float:
    """Return how many observations of 0 or 1 say as much as some rows whose values are from 0 to 1.

    For values of 0 and 1 that is the number of rows; it is never less. One imaginary row more, of variance 1/4 between
    rows and within, keeps few rows that are alike from seeming certain.

    Args:
        rows: Number of rows.
        share: Their mean.
        squares: Sum of their squared distances from the mean.
    """
    return max(rows, rows * (rows * share * (1 - share) + 0.25) / (squares + 0.25))


def standard_error(rows: int, mean: float, squares: float, within: Range | None) -> float | None:
    """Return the standard error of a mean; None if the sample does not tell.

    Where a range is declared, it is half the width of Wilson's score interval of one standard error, in that range, so
    that neither a single row nor rows that are all alike look certain. Otherwise it comes from the spread, and rows
    that are alike tell none.

    Args:
        rows: Number of rows.
        mean: Their mean.
        squares: Sum of their squared distances from the mean.
        within: The range that values can have; None if unknown.
    """
    if within is not None:
        low, width = within[0], within[1] - within[0]
        share = min(1.0, max(0.0, (mean - low) / width))
        return width * wilson(share, effective_size(rows, share, squares / width**2))[1]
    if rows < 2 or squares <= 1e-20 * (1e-80 + mean**2) * rows:  # but for rounding, equal
        return None
    return math.sqrt(squares / (rows - 1) / rows)


def shared_range(ranges: Iterable[Range | None], lowest: float, highest: float) -> Range | None:
    """Return the range of values of several environments; None if one declares none, or a value lies outside.

    Args:
        ranges: The range that each environment declares.
        lowest: The lowest value seen.
        highest: The highest value seen.
    """
    found = set(ranges)
    known = [each for each in found if each is not None]
    if not known or len(known) < len(found):
        return None
    low, high = min(each[0] for each in known), max(each[1] for each in known)
    rounding = 1e-9 * (high - low)
    return (low, high) if low < high and low - rounding <= lowest and highest <= high + rounding else None
