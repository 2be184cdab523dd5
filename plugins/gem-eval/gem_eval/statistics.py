"""Statistics of scores: estimates with intervals, and comparisons of two runs.

Values come by row, a sequence of the epochs of each; rows may have different numbers of epochs. Epochs of a row are not
independent, so all formulas use the means of rows, as if rows were drawn from a larger set of tasks (Miller, "Adding
error bars to evals", arXiv:2411.00640). A row without epochs is left out. The order of rows and epochs never matters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from gem_core.errors import ArgumentError
from gem_core.records import Range, effective_size, shared_range, standard_error, wilson

Rows = Sequence[Sequence[float]]
"""Values by row: one inner sequence for each row, with a value for each epoch."""
Counts = Sequence[tuple[int, int]]
"""For each row, its number of epochs and how many of them succeeded."""
_Floats = npt.NDArray[np.float64]

# Values of no declared range may lie beyond those seen by this share of their range. By simulation of 4 to 100 rows,
# intervals then cover more often than Student's t where returns are skewed or mostly 0, and are as wide for 4 rows.
_SEEN_BEYOND = 0.5


class Estimate(NamedTuple):
    """A mean with its uncertainty.

    Args:
        mean: The mean of the means of rows.
        stderr: Its standard error, clustered by row; None where the sample does not tell. It is that of the table
            of ``gem run``; see ``gem_core.records.standard_error``.
        low: Lower end of the interval; None where the sample does not tell.
        high: Upper end of the interval.
    """

    mean: float
    stderr: float | None
    low: float | None
    high: float | None


def rate(rows: Rows, confidence: float = 0.95) -> Estimate:
    """Estimate a rate from values between 0 and 1, such as successes: the ``mean`` within 0 and 1.

    Args:
        rows: Values by row, each from 0 to 1.
        confidence: Probability that the interval covers.

    Raises:
        ArgumentError: There are no values, or some lie outside of 0 to 1.
    """
    return mean(rows, confidence, within=(0.0, 1.0))


def mean(rows: Rows, confidence: float = 0.95, *, within: Range | None = None) -> Estimate:
    """Estimate the mean of any values, such as returns.

    Of values in a declared range, the interval is Wilson's, moved from 0 … 1 to that range, with the number of
    independent observations that would have the variance seen between rows (the effective sample size). For values at
    the two ends with one epoch a row, with one row, or where all epochs are alike, that is the number of rows.
    Otherwise it is larger, but for few rows reduced as Korn and Graubard do, by the squared ratio of the quantiles of
    the normal and the t distribution, never below the number of rows. The variance counts one imaginary row more whose
    epochs agree, so that few rows, or rare successes, do not seem more certain than they are.

    Of other values, the range is taken to be twice that of the rows seen. Where all rows have the same mean, or there
    is one, the sample does not tell its uncertainty: the estimate has the mean alone.

    Args:
        rows: Values by row.
        confidence: Probability that the interval covers.
        within: The range that values can have; None where it is not known.

    Raises:
        ArgumentError: There are no values, or some lie outside of the range.

    Source: E. B. Wilson, JASA 22 (1927), 209-212; E. L. Korn and B. I. Graubard, Survey Methodology 24 (1998), 193-201;
    C. Franco et al., J. Survey Statistics and Methodology 7 (2019), 334-364, who recommend Wilson's form.
    """
    means = row_means(rows)
    if within is not None and shared_range([within], means[0], means[-1]) is None:
        outside = means[0] if means[0] < within[0] else means[-1]
        raise ArgumentError(f"values from {within[0]:g} to {within[1]:g} were expected, not {outside:g}")
    return _estimate(means, confidence, within)


def pass_at(counts: Counts, k: int, confidence: float = 0.95) -> Estimate:
    """Estimate pass@k: the probability that at least one of k epochs of a row succeeds.

    Args:
        counts: For each row its number of epochs and of successes. Rows with fewer than k epochs are left out, since
            they have no unbiased estimate.
        k: Number of epochs.
        confidence: Probability that the interval covers; see ``rate``.

    Raises:
        ArgumentError: k is below 1, or no row has k epochs.

    Source: Chen et al., arXiv:2107.03374, section 2.1, without bias.
    """
    return _of_counts(counts, k, confidence, lambda n, c: (math.comb(n, k) - math.comb(n - c, k)) / math.comb(n, k))


def pass_hat(counts: Counts, k: int, confidence: float = 0.95) -> Estimate:
    """Estimate pass^k: the probability that all of k epochs of a row succeed.

    Args:
        counts: As for ``pass_at``.
        k: Number of epochs.
        confidence: Probability that the interval covers; see ``rate``.

    Raises:
        ArgumentError: k is below 1, or no row has k epochs.

    Source: Yao et al., tau-bench, arXiv:2406.12045, without bias.
    """
    return _of_counts(counts, k, confidence, lambda n, c: math.comb(c, k) / math.comb(n, k))


def differences(a: Rows, b: Rows) -> list[float]:
    """Return the difference ``a - b`` of the means of each row that both have values for.

    Raises:
        ArgumentError: The numbers of rows differ.
    """
    if len(a) != len(b):
        raise ArgumentError(f"a pair needs the same rows in the same order, not {len(a)} rows and {len(b)}")
    return [_mean_of(one) - _mean_of(other) for one, other in zip(a, b, strict=True) if len(one) and len(other)]


def paired_difference(a: Rows, b: Rows, confidence: float = 0.95, *, within: Range | None = None) -> Estimate:
    """Estimate the mean of ``a - b`` over the rows that both have, as a pair for each row.

    Args:
        a: Values by row.
        b: Values of the same rows in the same order.
        confidence: Probability that the interval covers.
        within: The range that values can have, as ``(0, 1)`` for successes; None where it is not known. See ``mean``:
            with a range, the interval stays within what two values can differ by, and has a width also where no row
            differs.

    Raises:
        ArgumentError: The numbers of rows differ, or there are no values in common.
    """
    apart = row_means([[value] for value in differences(a, b)])
    return _estimate(apart, confidence, within and (within[0] - within[1], within[1] - within[0]))


def mcnemar(only_a: int, only_b: int) -> float:
    """Test whether two agents solve equally many tasks; return the two-sided p-value.

    The exact binomial test, which never raises more false alarms than its level; mid-p values would be less cautious,
    but can. With several epochs a row use ``permutation_test``; with one epoch it is the same test.

    Args:
        only_a: Number of rows that only the first solved.
        only_b: Number of rows that only the second solved.

    Source: Q. McNemar, Psychometrika 12 (1947), 153-157.
    """
    from scipy.special import bdtr  # type: ignore[import-untyped]

    return min(1.0, 2 * float(bdtr(min(only_a, only_b), only_a + only_b, 0.5)))


def permutation_test(differences: Sequence[float], seed: int = 0, resamples: int = 9_999) -> float:
    """Test whether the mean of paired differences is 0; return the two-sided p-value.

    If two agents are alike, the sign of each row's difference is chance. SciPy's test tries all assignments of signs
    for up to 13 rows that differ; for more, random ones, with the seen one among them: p = (b + 1) / (resamples + 1).

    Args:
        differences: One for each row, as of ``differences``.
        seed: Seed of the random assignments.
        resamples: Number of them.

    Source: B. Phipson and G. K. Smyth, Statistical Applications in Genetics and Molecular Biology 9 (2010), article 39.
    """
    from scipy import stats  # type: ignore[import-untyped]

    values = np.sort(np.asarray(differences, dtype=float))
    values = values[values != 0]
    if len(values) < 2:
        return 1.0
    found = stats.permutation_test(
        (values,),
        np.sum,
        permutation_type="samples",
        vectorized=True,
        n_resamples=resamples,
        batch=max(1, 4_000_000 // len(values)),  # 32 MB
        random_state=np.random.default_rng(seed),
    )
    return float(found.pvalue)


def more_rows_needed(differences: Sequence[float], p: float, power: float = 0.8, alpha: float = 0.05) -> int | None:
    """Return how many more rows would settle the difference seen.

    It is settled if ``p`` is at most ``alpha``. Otherwise the answer is the number of rows with
    which a two-sided paired t-test finds a true difference of this size and spread with probability ``power``, less
    those that there are. The exact tests above find differences of rates a little less often (0.75 to 0.78 instead of
    0.8 in simulations). It is at least what lets the permutation test reach ``alpha`` if as large a share of rows
    differs as now.

    Args:
        differences: One for each row, as of ``differences``.
        p: Their p-value, as of ``permutation_test``.
        power: Probability that the difference is found.
        alpha: Level of the test.

    Returns:
        0 where the rows settle it already; None where no number would, since the difference is 0, or where there are
        fewer than two rows.

    Source: W. C. Guenther, The American Statistician 35 (1981), 243-244.
    """
    values = np.asarray(differences, dtype=float)
    rows = len(values)
    if rows < 2 or abs(center := _mean_of(values)) <= 1e-12 * np.max(np.abs(values)):  # 0, but for rounding
        return None
    if p <= alpha:
        return 0
    normal = NormalDist()
    critical = normal.inv_cdf(1 - alpha / 2)
    ratio = (critical + normal.inv_cdf(power)) * float(np.std(values, ddof=1)) / abs(center)
    least = math.ceil(1 + math.log2(1 / alpha)) * rows / np.count_nonzero(values)
    return max(math.ceil(ratio**2 + critical**2 / 2), math.ceil(least), rows + 1) - rows


def row_means(rows: Rows) -> _Floats:
    """Return the means of rows, float64, in ascending order; rows without values are left out.

    Raises:
        ArgumentError: No row has values, or one is not finite.
    """
    means = np.sort([_mean_of(row) for row in rows if len(row)])
    if not len(means):
        raise ArgumentError("no values to estimate a mean from: every row is empty")
    if not np.isfinite(means).all():
        raise ArgumentError("a mean takes finite values: leave out NaN and infinity, and count them apart")
    return means


def _mean_of(values: Sequence[float] | _Floats) -> float:
    # fsum rounds once, so that the order does not matter.
    return math.fsum(values) / len(values)


def _estimate(means: _Floats, confidence: float, within: Range | None) -> Estimate:
    """Return the estimate from the means of rows; see ``mean``."""
    from scipy.special import ndtri, stdtrit

    center, rows = _mean_of(means), len(means)
    squares = float(np.sum((means - center) ** 2))
    stderr = standard_error(rows, center, squares, within)
    probability = (1 + confidence) / 2
    if stderr is None:
        return Estimate(center, None, None, None)
    if within is None:
        beyond = _SEEN_BEYOND * float(means[-1] - means[0])
        within = (float(means[0]) - beyond, float(means[-1]) + beyond)
    least, width = within[0], within[1] - within[0]
    share, normal, size = min(1.0, max(0.0, (center - least) / width)), float(ndtri(probability)), float(rows)
    if rows > 1:
        few = (normal / float(stdtrit(rows - 1, probability))) ** 2
        size = max(size, effective_size(rows, share, squares / width**2) * few)
    middle, half = wilson(share, size, normal)
    # Rounding alone could leave these bounds.
    low, high = max(0.0, min(share, middle - half)), min(1.0, max(share, middle + half))
    return Estimate(center, stderr, min(center, least + width * low), max(center, least + width * high))


def _of_counts(counts: Counts, k: int, confidence: float, share: Callable[[int, int], float]) -> Estimate:
    if k < 1:
        raise ArgumentError(f"k is a number of epochs, 1 or more, not {k}")
    rows = [[share(epochs, successes)] for epochs, successes in counts if epochs >= k]
    if not rows:
        raise ArgumentError(f"no row has {k} epochs, as pass@{k} and pass^{k} need; play more epochs, or lower k")
    return rate(rows, confidence)
