"""Intervals over seeds, beside SciPy's."""

from __future__ import annotations

import math

import pytest

from gem_train.reporting import mean_interval
from gem_train.reporting.intervals import t_quantile


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 5, 9, 10, 29, 30, 99, 500])
def test_quantiles_are_those_of_scipy(degrees: int):
    stats = pytest.importorskip("scipy.stats")
    for probability in (0.75, 0.95, 0.975, 0.995):
        assert t_quantile(probability, degrees) == pytest.approx(stats.t.ppf(probability, degrees), rel=1e-9)


def test_interval_is_that_of_scipy():
    """Five seeds, as of a study."""
    stats = pytest.importorskip("scipy.stats")
    values = [4.91, 4.95, 4.88, 4.93, 5.02]
    expected = stats.t.interval(0.95, 4, loc=sum(values) / 5, scale=stats.sem(values))
    found = mean_interval(values)
    assert found.mean == pytest.approx(sum(values) / 5)
    assert (found.low, found.high) == pytest.approx(expected)


def test_one_value_tells_no_spread():
    """The interval of one seed is unknown, not of width 0."""
    assert mean_interval([0.5]) == (0.5, None, None)


def test_no_values_have_no_mean():
    found = mean_interval([])
    assert math.isnan(found.mean)
    assert found[1:] == (None, None)
