"""Numbers in words: scores, intervals, shares, times and amounts."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from statistics import fmean
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gem_eval.records import Row
    from gem_eval.scores import Metric

NONE = "-"


def score(value: float | None, metric: Metric) -> str:
    """Return a score: a success in percent, a return as a number."""
    if value is None:
        return NONE
    return f"{100 * value:.1f} %" if metric == "success" else number(value)


def bounds(low: float | None, high: float | None, metric: Metric) -> str:
    """Return an interval; a dash where the sample does not tell."""
    if low is None or high is None:
        return NONE
    if metric == "success":
        return f"{100 * low:.1f} to {100 * high:.1f}"
    return f"{number(low)} to {number(high)}"


def difference(value: float, metric: Metric) -> str:
    """Return a difference with its sign; of successes in percentage points."""
    return f"{100 * value:+.1f}" if metric == "success" else f"{value:+.3g}"


def number(value: float) -> str:
    """Return a number with three digits, or all before the point."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def p_value(p: float) -> str:
    """Return a p-value."""
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def duration(seconds: float) -> str:
    """Return a time as it is said: 45 s, 12 min, 3.5 h."""
    if seconds < 100:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.0f} min" if seconds < 100 * 60 else f"{seconds / 3600:.1f} h"


def dollars(amount: float) -> str:
    """Return an amount in US dollars."""
    return f"${amount:,.2f}" if amount >= 1 else f"${amount:.3g}"


def moment(seconds: float) -> str:
    """Return a time since 1970 as a date."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M UTC")


def mean_of(rows: Sequence[Row], name: str) -> float | None:
    """Return the mean of a field over the episodes that have it."""
    values = [value for row in rows if (value := getattr(row, name)) is not None]
    return fmean(values) if values else None
