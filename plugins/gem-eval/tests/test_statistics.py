"""Formulas of scores: against SciPy and statsmodels, against published numbers, and what holds for any values."""

from __future__ import annotations

import math
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_core.errors import ArgumentError
from gem_eval.statistics import (
    Estimate,
    differences,
    mcnemar,
    mean,
    more_rows_needed,
    paired_difference,
    pass_at,
    pass_hat,
    permutation_test,
    rate,
)

if TYPE_CHECKING:
    from random import Random

RETURNS = st.lists(st.lists(st.floats(-10, 10), min_size=1, max_size=3), min_size=1, max_size=12)


def ends(estimate: Estimate) -> tuple[float, float]:
    """The interval of an estimate that has one."""
    assert estimate.low is not None
    assert estimate.high is not None
    return estimate.low, estimate.high


@pytest.mark.parametrize(("solved", "rows"), [(0, 7), (1, 9), (15, 30), (99, 100), (1, 1)])
@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_one_epoch_each_is_wilsons_interval(solved: int, rows: int, confidence: float) -> None:
    """The interval is exactly that of SciPy."""
    stats = pytest.importorskip("scipy.stats")
    expected = stats.binomtest(solved, rows).proportion_ci(confidence, "wilson")
    found = rate([[1]] * solved + [[0]] * (rows - solved), confidence)
    assert ends(found) == pytest.approx((expected.low, expected.high), abs=1e-12)


@pytest.mark.parametrize("rows", [10, 25, 2_000])
def test_effective_sample_size_is_that_of_the_variance_between_rows(rows: int) -> None:
    """One imaginary row more, and Korn and Graubard's factor; statsmodels' Wilson interval of that size."""
    proportion = pytest.importorskip("statsmodels.stats.proportion")
    stats = pytest.importorskip("scipy.stats")
    solved = np.random.default_rng(rows).binomial(6, 0.3, rows)
    share = solved.mean() / 6
    inflation = (np.sum((solved / 6 - share) ** 2) + 0.25) / (rows * share * (1 - share) + 0.25)
    size = rows / inflation * (stats.norm.ppf(0.975) / stats.t.ppf(0.975, rows - 1)) ** 2
    assert size > rows
    expected = proportion.proportion_confint(share * size, size, method="wilson")
    assert ends(rate([[1] * each + [0] * (6 - each) for each in solved])) == pytest.approx(expected, rel=1e-6)


def test_the_interval_within_a_range_is_moved_with_it() -> None:
    """Of values at its two ends, it is Wilson's, also where all are alike; without a range, twice what was seen."""
    stats = pytest.importorskip("scipy.stats")
    rows = [[3.0], [-1.0], [3.0], [3.0]]
    wilsons = stats.binomtest(3, 4).proportion_ci(0.95, "wilson")
    assert ends(mean(rows, within=(-1.0, 3.0))) == pytest.approx((4 * wilsons.low - 1, 4 * wilsons.high - 1))
    low, high = ends(mean([[3.0]] * 4, within=(-1.0, 3.0)))
    assert low < 2
    assert high == 3
    values = [[0.1], [0.9], [0.3], [0.2]]
    assert ends(mean(values)) == pytest.approx(ends(mean(values, within=(-0.3, 1.3))))


@pytest.mark.parametrize("values", [[[], []], [[0.5], [2]], [[1.0], [math.nan]]])
def test_no_values_or_wrong_ones_are_refused(values: list[list[float]]) -> None:
    with pytest.raises(ArgumentError):
        rate(values)


@pytest.mark.parametrize(("epochs", "solved", "k"), [(5, 2, 1), (5, 2, 3), (5, 4, 2), (4, 0, 2), (4, 4, 4), (3, 1, 3)])
def test_pass_at_and_pass_hat_are_unbiased(epochs: int, solved: int, k: int) -> None:
    """They are the share of all draws of k epochs of which one, or each, succeeded."""
    draws = list(combinations([True] * solved + [False] * (epochs - solved), k))
    assert pass_at([(epochs, solved)], k).mean == pytest.approx(sum(map(any, draws)) / len(draws))
    assert pass_hat([(epochs, solved)], k).mean == pytest.approx(sum(map(all, draws)) / len(draws))


@pytest.mark.parametrize(("only_a", "only_b"), [(0, 0), (0, 1), (3, 3), (2, 9), (40, 61), (700, 800)])
def test_mcnemar_is_the_exact_test(only_a: int, only_b: int) -> None:
    table = pytest.importorskip("statsmodels.stats.contingency_tables")
    expected = table.mcnemar([[5, only_a], [only_b, 5]], exact=True).pvalue
    assert mcnemar(only_a, only_b) == pytest.approx(min(1, expected), rel=1e-9)


def test_permutation_test_agrees_with_mcnemars() -> None:
    """Exact for few rows, near it for many: the same test as McNemar's if rows differ by one epoch, in any order."""
    assert permutation_test([1] * 9 + [-1] * 3 + [0] * 20) == pytest.approx(mcnemar(9, 3))
    assert permutation_test([1] * 30 + [-1] * 15) == pytest.approx(mcnemar(30, 15), abs=0.01)
    assert permutation_test([0.0, 0.0]) == 1
    assert permutation_test([1] * 80) == 2 / 10_000
    assert permutation_test([0.5, -0.1, 0.3] * 9) == permutation_test([0.3, 0.5, -0.1] * 9)


def test_paired_difference_is_of_rows_that_both_have() -> None:
    a, b = [[1.0, 0.5], [], [3.0]], [[0.5], [1.0], [2.0, 0.0]]
    assert differences(a, b) == [0.25, 2.0]
    assert paired_difference(a, b).mean == 1.125
    with pytest.raises(ArgumentError, match="3 rows and 2"):
        differences(a, b[:2])


@pytest.mark.parametrize(("center", "rows"), [(0.3, 20), (0.1, 50), (0.7, 6)])
def test_more_rows_needed_is_the_power_of_a_paired_t_test(center: float, rows: int) -> None:
    power = pytest.importorskip("statsmodels.stats.power")
    spread = np.random.default_rng(0).normal(0, 1, rows)
    apart = (spread - spread.mean()) / spread.std(ddof=1) + center
    expected = power.TTestPower().solve_power(center, alpha=0.05, power=0.8)
    found = more_rows_needed(apart.tolist(), 0.2)
    assert found is not None
    assert abs(rows + found - expected) <= 1


def test_more_rows_needed_says_when_none_or_no_number_would() -> None:
    assert more_rows_needed([1.0, 0.9, 1.1] * 10, 0.001) == 0
    assert more_rows_needed([0.1, 0.2, -0.3], 1.0) is None
    assert more_rows_needed([1.0], 1.0) is None
    assert more_rows_needed([1.0, 1.0], 0.5) == 4  # six rows of one sign are the fewest that reach 5 %
    assert more_rows_needed([1.0] * 5 + [0.0] * 3, 0.0625) == 2  # five of eight differ, so about six of ten will


def test_standard_error_is_clustered_by_row() -> None:
    """It equals statsmodels' with clusters, for rows of equal numbers of epochs; within a range, it is near it."""
    api = pytest.importorskip("statsmodels.api")
    values = np.random.default_rng(1).binomial(1, np.repeat([[0.1], [0.5], [0.9], [0.7]], 5, axis=0), (20, 3))
    fit = api.OLS(values.ravel().astype(float), np.ones(60)).fit(
        cov_type="cluster", cov_kwds={"groups": np.repeat(np.arange(20), 3)}
    )
    assert rate(values.tolist()).stderr == pytest.approx(fit.bse[0], rel=0.1)
    assert mean(values.tolist()).stderr == pytest.approx(fit.bse[0], rel=1e-9)


def test_a_sample_that_does_not_tell_its_spread_is_not_certain() -> None:
    """A rate has a wide interval all the same, a mean of unknown range none; so has a difference of rates."""
    for rows in ([[1] * 50], [[0.5]], [[1]] * 5, [[0, 0]] * 5):
        low, high = ends(rate(rows))
        assert high - low > 0.4
    for values in ([[0.25, 0.75]], [[0.5], [0.5], [0.5]], [[0], [0], [0]]):
        assert mean(values) == (sum(values[0]) / len(values[0]), None, None, None)
    same = ends(paired_difference([[1], [0]] * 10, [[1], [0]] * 10, within=(0, 1)))
    assert -1 < same[0] < 0 < same[1] < 1
    all_of_them = ends(paired_difference([[1]] * 10, [[0]] * 10, within=(0, 1)))
    assert 0.4 < all_of_them[0] < all_of_them[1] == 1


@given(RETURNS, st.randoms(use_true_random=False))
def test_estimates_do_not_depend_on_order_or_copies(rows: list[list[float]], random: Random) -> None:
    """Rows and epochs in another order, and epochs twice, give the same estimate; the interval holds the mean."""
    random.shuffle(mixed := [sorted(row) for row in rows])
    for within in (None, (-10.0, 10.0)):
        found = mean(rows, within=within)
        assert mean(mixed, within=within) == found
        assert mean([row * 2 for row in rows], within=within)[:2] == pytest.approx(found[:2], abs=1e-9)
        if within is not None or found.low is not None:
            low, high = ends(found)
            assert low <= found.mean <= high
            assert within is None or within[0] <= low < high <= within[1]


@pytest.mark.parametrize(
    ("kind", "rows", "least"),
    [
        ("rates", 30, 0.93),
        ("exponential", 30, 0.93),
        ("in a range", 5, 0.93),
        *(
            pytest.param(kind, rows, 0.83 if kind == "mostly zero" and rows <= 10 else 0.89, marks=pytest.mark.thorough)
            for kind, rows in product(["rates", "normal", "exponential", "mostly zero", "in a range"], [5, 10, 100])
        ),
    ],
)
def test_intervals_cover(kind: str, rows: int, least: float) -> None:
    """Of 95 % intervals, about as many cover; rows without an interval, since they are alike, count as covered."""
    generator, tries, covered = np.random.default_rng(rows), 500, 0
    for _ in range(tries):
        values, center = {
            "rates": (generator.binomial(4, generator.beta(0.3, 0.3, rows)) / 4, 0.5),
            "normal": (generator.normal(0, 1, rows), 0.0),
            "exponential": (generator.exponential(1, rows), 1.0),
            "mostly zero": (generator.exponential(1, rows) * (generator.random(rows) < 0.3), 0.3),
            "in a range": (generator.beta(0.4, 0.8, rows), 1 / 3),
        }[kind]
        found = mean([[value] for value in values], within=(0.0, 1.0) if kind in ("rates", "in a range") else None)
        covered += found.low is None or found.high is None or found.low <= center <= found.high
    assert least <= covered / tries <= 1 - (rows == 30) * 0.01
