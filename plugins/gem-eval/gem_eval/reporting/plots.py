"""Where the shapes of plots lie; ``assets/plots.html`` draws them.

Series are numbered from 0; the page has a colour for each of the first ``COLOURS``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

COLOURS = 8

_ROW_WIDTH, _MARGIN = 220, 6
_WIDTH, _HEIGHT = 320, 170
_LEFT, _RIGHT, _TOP, _BOTTOM = 40, 20, 8, 36
_INNER, _FLOOR = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _BOTTOM


class Scale(NamedTuple):
    """A range of numbers with round ticks.

    Args:
        low: Its lower end.
        high: Its upper end, above it.
        ticks: Numbers to write, in ascending order.
        percent: Whether numbers are shares, written as percentages.
    """

    low: float
    high: float
    ticks: Sequence[float]
    percent: bool = False

    @classmethod
    def of(cls, values: Iterable[float], count: int = 4, *, percent: bool = False) -> Scale:
        """Return a scale that holds some values, with about ``count`` steps."""
        found = [value for value in values if math.isfinite(value)] or [0.0, 1.0]
        low, high = min(found), max(found)
        if high - low < 1e-9 * max(abs(low), abs(high), 1e-9):
            low, high = low - 0.5 * (abs(low) or 1), high + 0.5 * (abs(high) or 1)
        step = _round_step((high - low) / count)
        first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
        ticks = [number * step for number in range(first, last + 1)]
        return cls(ticks[0], ticks[-1], ticks, percent)

    def at(self, value: float) -> float:
        """Return where a value lies, from 0 to 1."""
        return min(max((value - self.low) / (self.high - self.low), 0.0), 1.0)

    def across(self, value: float) -> str:
        """Return where a value lies in a row of a table, in pixels."""
        return f"{_MARGIN + (_ROW_WIDTH - 2 * _MARGIN) * self.at(value):.1f}"

    def up(self, value: float) -> str:
        """Return where a value lies in a figure, in pixels from above."""
        return f"{_FLOOR - (_FLOOR - _TOP) * self.at(value):.1f}"

    def label(self, value: float) -> str:
        """Return a number as it is written at a tick."""
        return f"{100 * value:.10g}" if self.percent else _short(value)


SHARES = Scale(0.0, 1.0, (0.0, 0.25, 0.5, 0.75, 1.0), percent=True)


class Point(NamedTuple):
    """A point of ``scatter``.

    Args:
        series: Its series.
        x: Across.
        y: Upwards, with its interval.
        low: Lower end of the interval of y.
        high: Upper end of the interval of y.
        title: What it is.
        whole: Whether it stands for all of the series, and is drawn larger.
    """

    series: int
    x: float
    y: float
    low: float
    high: float
    title: str
    whole: bool


@dataclass(frozen=True)
class Figure:
    """A plot in a frame: places in pixels, as text.

    Args:
        name: Stands above.
        title: What it is, for a reader who does not see it.
        x_label: What stands below.
        scale: Upwards.
        across: Where numbers stand across, and what they are.
        bars: Of each its series, place and size.
        points: As ``Point``, with places as text.
    """

    name: str
    title: str
    x_label: str
    scale: Scale
    across: list[tuple[str, str]]
    bars: list[dict[str, object]] = field(default_factory=list)
    points: list[dict[str, object]] = field(default_factory=list)

    @property
    def upwards(self) -> list[tuple[str, str]]:
        """Where numbers stand upwards, and what they are."""
        unit = " %" if self.scale.percent else ""
        return [(self.scale.up(tick), f"{self.scale.label(tick)}{unit}") for tick in self.scale.ticks]


def columns(
    heights: Sequence[tuple[int, Sequence[float]]],
    ticks: Sequence[tuple[float, str]],
    x_label: str,
    title: str,
    name: str,
) -> Figure:
    """Draw shares as columns, those of several series side by side.

    Args:
        heights: Of each series its number and a share for each column.
        ticks: Where numbers stand across, in columns, and what they are.
        x_label: What stands below.
        title: What it is.
        name: What stands above.
    """
    most = max((share for _, shares in heights for share in shares), default=0.0) or 1.0
    scale = Scale.of([0.0, most], 3, percent=True)
    count = max((len(shares) for _, shares in heights), default=1) or 1
    step = _INNER / count
    width = step * (0.92 if count > 8 else 0.7) / len(heights)
    bars: list[dict[str, object]] = []
    for place, (series, shares) in enumerate(heights):
        for column, share in enumerate(shares):
            if share:
                left = _LEFT + step * column + (step - width * len(heights)) / 2 + width * place
                tall = max(scale.at(share) * (_FLOOR - _TOP), 1)
                size = {"width": f"{max(width - (width > 4), 0.8):.1f}", "height": f"{tall:.1f}"}
                bars.append({"series": series % COLOURS, "x": f"{left:.1f}", "y": f"{_FLOOR - tall:.1f}", **size})
    across = [(f"{_LEFT + step * where:.1f}", label) for where, label in ticks]
    return Figure(name, title, x_label, scale, across, bars=bars)


def histogram(values: Sequence[tuple[int, Sequence[float]]], x_label: str, title: str) -> Figure:
    """Draw how numbers are distributed, as shares of each series.

    Args:
        values: Of each series its number and its values; those that are not finite are left out.
        x_label: What stands below.
        title: What it is.
    """
    finite = [(series, [value for value in own if math.isfinite(value)]) for series, own in values]
    every = [value for _, own in finite for value in own]
    low, high = min(every, default=0.0), max(every, default=1.0)
    whole = all(value == int(value) for value in every) and high - low < 30
    if whole:
        start, step, count = low, 1.0, int(high - low) + 1
        skipped = math.ceil(count / 10)
        ticks = [(place + 0.5, _short(start + place)) for place in range(0, count, skipped)]
    else:
        scale = Scale.of(every, 4)
        parts = max(round(16 / (len(scale.ticks) - 1)), 2)
        start, step = scale.low, (scale.ticks[1] - scale.ticks[0]) / parts
        count = parts * (len(scale.ticks) - 1)
        ticks = [(parts * place, scale.label(tick)) for place, tick in enumerate(scale.ticks)]
    heights = []
    for series, own in finite:
        counts = [0] * count
        for value in own:
            counts[min(int((value - start) / step + 1e-9), count - 1)] += 1
        heights.append((series, [each / max(len(own), 1) for each in counts]))
    return columns(heights, ticks, x_label, title, title)


def scatter(points: Sequence[Point], x_label: str, scale: Scale, title: str) -> Figure:
    """Draw points with the whiskers of their intervals; numbers across are on a logarithmic scale from 10 to 1 on.

    Args:
        points: The points; x above 0.
        x_label: What stands below.
        scale: Upwards.
        title: What it is.
    """
    amounts = [point.x for point in points]
    logarithmic = max(amounts) > 10 * min(amounts)
    if logarithmic:
        low = math.floor(math.log10(min(amounts)))
        high = max(math.ceil(math.log10(max(amounts))), low + 1)
        x_scale = Scale(low, high, range(low, high + 1))
    else:
        x_scale = Scale.of([0.0, *amounts], 4)

    def across(place: float) -> str:
        return f"{_LEFT + _INNER * x_scale.at(place):.1f}"

    ticks = [(across(tick), _short(10**tick) if logarithmic else x_scale.label(tick)) for tick in x_scale.ticks]
    drawn: list[dict[str, object]] = [
        {
            **point._asdict(),
            "series": point.series % COLOURS,
            "x": across(math.log10(point.x) if logarithmic else point.x),
            **{name: scale.up(getattr(point, name)) for name in ("y", "low", "high")},
        }
        for point in sorted(points, key=lambda point: point.whole)
    ]
    return Figure(title, title, x_label, scale, ticks, points=drawn)


def _short(value: float) -> str:
    """Return a number in few characters: 0.25, 1,200, 45k, 3.1M."""
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e4, "k")):
        if abs(value) >= size:
            return f"{value / (1e3 if unit == 'k' else size):.3g}{unit}"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _round_step(step: float) -> float:
    size = 10.0 ** math.floor(math.log10(step))
    return next(factor * size for factor in (1, 2, 2.5, 5, 10) if factor * size >= step * (1 - 1e-9))
