"""Times and amounts in words."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from statistics import fmean
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gem_eval.records import Row


def number(value: float) -> str:
    """Return a number with three digits, or all before the point."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


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
