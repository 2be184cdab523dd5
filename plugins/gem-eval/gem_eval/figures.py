"""Scores, differences, p-values, times and amounts as tables and reports show them."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from gem_core.cli import counted

if TYPE_CHECKING:
    from gem_eval.scores import Metric, Score
    from gem_eval.statistics import Estimate

NONE = "-"


def score(value: float | None, metric: Metric) -> str:
    """Return a score: a success in percent, a return as a number."""
    if value is None:
        return NONE
    return f"{value:.1%}" if metric == "success" else f"{value:.3f}"


def bounds(low: float | None, high: float | None, metric: Metric) -> str:
    """Return an interval; a dash where the sample does not tell."""
    if low is None or high is None:
        return NONE
    return f"{100 * low:.1f} to {100 * high:.1f}" if metric == "success" else f"{low:.3f} to {high:.3f}"


def with_bounds(estimate: Estimate | Score | None, metric: Metric) -> str:
    """Return a score with its interval, as far as they are known."""
    if estimate is None or estimate.mean is None:
        return NONE
    shown = score(estimate.mean, metric)
    if estimate.low is None or estimate.high is None:
        return shown
    low, high = (score(end, metric).removesuffix("%") for end in (estimate.low, estimate.high))
    return f"{shown} [{low}, {high}]"


def pass_note(score: Score) -> str:
    """Return how many rows the largest k of pass@k leaves out; empty for none."""
    k, left_out = max(score.pass_left_out.items(), key=lambda each: int(each[0]), default=("1", 0))
    if not left_out:
        return ""
    rows = f"{counted(left_out, 'row')} with fewer than {k} episodes that count"
    return f"pass@{k} and pass^{k} of {score.model} at {score.id} leave out {rows}."


def change(value: float | None, metric: Metric) -> str:
    """Return a difference with its sign: of successes in percentage points."""
    if value is None:
        return NONE
    return f"{100 * value:+.1f}" if metric == "success" else f"{value:+.3f}"


def change_bounds(low: float | None, high: float | None, metric: Metric) -> str:
    """Return the interval of a difference; a dash where the sample does not tell."""
    return NONE if low is None or high is None else f"{change(low, metric)} to {change(high, metric)}"


def p_value(p: float | None) -> str:
    """Return a p-value."""
    return NONE if p is None else "< 0.001" if p < 0.001 else f"{p:.3f}"


def amount(name: str, value: float | None) -> str:
    """Return a number: of ``"cost"`` as dollars, of ``"seconds"`` as it is said (45 s, 12 min, 3.5 h)."""
    if value is None:
        return NONE
    if name == "cost":
        return f"${value:,.2f}" if value >= 1 else f"${value:.3g}"
    if name == "seconds" and value >= 100:
        return f"{value / 60:.0f} min" if value < 100 * 60 else f"{value / 3600:.1f} h"
    shown = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return f"{shown} s" if name == "seconds" else shown


def moment(seconds: float) -> str:
    """Return a time since 1970 as a date."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M UTC")
