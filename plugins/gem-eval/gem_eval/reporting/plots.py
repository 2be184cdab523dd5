"""Plots as SVG, to stand inside of a page: what is drawn has classes, which the page's style colours.

Series are numbered from 0; the page has a colour for each of the first ``COLOURS``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from gem_eval.reporting import markup

COLOURS = 8

_ROW_WIDTH, _ROW_HEIGHT, _MARGIN = 220, 18, 6
_WIDTH, _HEIGHT = 320, 170
_LEFT, _RIGHT, _TOP, _BOTTOM = 40, 20, 8, 36


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

    def label(self, value: float) -> str:
        """Return a number as it is written at a tick."""
        return f"{100 * value:.10g}" if self.percent else short(value)


SHARES = Scale(0.0, 1.0, (0.0, 0.25, 0.5, 0.75, 1.0), percent=True)


class Point(NamedTuple):
    """A point of ``scatter``.

    Args:
        series: Its series.
        x: Across.
        y: Upwards.
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


def short(value: float) -> str:
    """Return a number in few characters: 0.25, 1,200, 45k, 3.1M."""
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e4, "k")):
        if abs(value) >= size:
            return f"{value / (1e3 if unit == 'k' else size):.3g}{unit}"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def interval(mean: float, low: float | None, high: float | None, scale: Scale, series: int, title: str) -> str:
    """Draw a mean with the whiskers of its interval, for one row of a table."""
    middle = _ROW_HEIGHT / 2
    shapes = [_grid(scale)]
    if low is not None and high is not None:
        left, right = _across(scale, low), _across(scale, high)
        shapes.append(f'<path class="s{series % COLOURS} whisker" d="M{left:.1f} {middle}H{right:.1f}')
        shapes.append(f'M{left:.1f} {middle - 4}v8M{right:.1f} {middle - 4}v8"/>')
    shapes.append(f'<circle class="s{series % COLOURS} dot" cx="{_across(scale, mean):.1f}" cy="{middle}" r="4.5"/>')
    return _svg(_ROW_WIDTH, _ROW_HEIGHT, "".join(shapes), title)


def no_interval(scale: Scale) -> str:
    """Draw the lines of the scale alone, for a row without a score."""
    return _svg(_ROW_WIDTH, _ROW_HEIGHT, _grid(scale), "no score")


def axis(scale: Scale) -> str:
    """Draw the numbers over a column of ``interval``."""
    labels = [
        f'<text x="{_across(scale, tick):.1f}" y="11" text-anchor="{_anchor(scale, tick)}">{scale.label(tick)}</text>'
        for tick in scale.ticks
    ]
    return _svg(_ROW_WIDTH, 14, "".join(labels), "")


def stacked(parts: Sequence[tuple[str, int]], title: str) -> str:
    """Draw counts as a bar of pieces, as wide as its place.

    Args:
        parts: Of each piece the class, and the count.
        title: What it is.
    """
    total = sum(count for _, count in parts) or 1
    shapes, left = [], 0.0
    for name, count in parts:
        width = 1000 * count / total
        shapes.append(f'<rect class="{name}" x="{left:.2f}" y="0" width="{width:.2f}" height="16"/>')
        left += width
    return (
        f'<svg class="stack" viewBox="0 0 1000 16" preserveAspectRatio="none" role="img">{_title(title)}'
        f"{''.join(shapes)}</svg>"
    )


def swatch(name: str) -> str:
    """Draw a colour for a legend."""
    square = f'<rect class="{name}" width="12" height="12" rx="2"/>'
    return f'<svg class="swatch" width="12" height="12" aria-hidden="true">{square}</svg>'


def columns(
    heights: Sequence[tuple[int, Sequence[float]]], ticks: Sequence[tuple[float, str]], x_label: str, title: str
) -> str:
    """Draw shares as columns, those of several series side by side.

    Args:
        heights: Of each series its number and a share for each column.
        ticks: Where numbers stand across, in columns, and what they are.
        x_label: What stands below.
        title: What it is.
    """
    most = max((share for _, shares in heights for share in shares), default=0.0) or 1.0
    scale = Scale.of([0.0, most], 3, percent=True)
    count = max((len(shares) for _, shares in heights), default=1) or 1
    width, floor = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _BOTTOM
    step = width / count
    bar = step * (0.92 if count > 8 else 0.7) / len(heights)
    shapes = [_upwards(scale)]
    for place, (series, shares) in enumerate(heights):
        for column, share in enumerate(shares):
            if share:
                left = _LEFT + step * column + (step - bar * len(heights)) / 2 + bar * place
                tall = max(scale.at(share) * (floor - _TOP), 1)
                shapes.append(
                    f'<rect class="s{series % COLOURS} bar" x="{left:.1f}" y="{floor - tall:.1f}" '
                    f'width="{max(bar - (bar > 4), 0.8):.1f}" height="{tall:.1f}"/>'
                )
    shapes += [
        f'<text x="{_LEFT + step * where:.1f}" y="{floor + 14}" text-anchor="middle">{markup.text(label)}</text>'
        for where, label in ticks
    ]
    shapes.append(_below(x_label))
    return _svg(_WIDTH, _HEIGHT, "".join(shapes), title)


def histogram(values: Sequence[tuple[int, Sequence[float]]], x_label: str, title: str) -> str:
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
        ticks = [(place + 0.5, short(start + place)) for place in range(0, count, skipped)]
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
    return columns(heights, ticks, x_label, title)


def scatter(points: Sequence[Point], x_label: str, scale: Scale, title: str) -> str:
    """Draw points with the whiskers of their intervals; numbers across are on a logarithmic scale from 10 to 1 on.

    Args:
        points: The points; x above 0.
        x_label: What stands below.
        scale: Upwards.
        title: What it is.
    """
    logarithmic = max(point.x for point in points) > 10 * min(point.x for point in points)
    x_scale = _powers([point.x for point in points]) if logarithmic else Scale.of([0.0, *(p.x for p in points)], 4)
    floor, width = _HEIGHT - _BOTTOM, _WIDTH - _LEFT - _RIGHT

    def across(value: float) -> float:
        return _LEFT + width * x_scale.at(math.log10(value) if logarithmic else value)

    def up(value: float) -> float:
        return floor - (floor - _TOP) * scale.at(value)

    shapes = [_upwards(scale)]
    for tick in x_scale.ticks:
        where, label = _LEFT + width * x_scale.at(tick), short(10**tick) if logarithmic else x_scale.label(tick)
        shapes.append(f'<path class="grid" d="M{where:.1f} {_TOP}V{floor}"/>')
        shapes.append(f'<text x="{where:.1f}" y="{floor + 14}" text-anchor="middle">{label}</text>')
    for point in sorted(points, key=lambda point: point.whole):
        name = f"s{point.series % COLOURS}"
        x, y = across(point.x), up(point.y)
        kind = "" if point.whole else " faint"
        shapes.append(f'<g class="{name}{kind}">{_title(point.title)}')
        if point.whole:
            shapes.append(f'<path class="{name} whisker" d="M{x:.1f} {up(point.low):.1f}V{up(point.high):.1f}"/>')
        shapes.append(f'<circle class="{name} dot" cx="{x:.1f}" cy="{y:.1f}" r="{5 if point.whole else 3.5}"/></g>')
    shapes.append(_below(x_label))
    return _svg(_WIDTH, _HEIGHT, "".join(shapes), title)


def _powers(values: Sequence[float]) -> Scale:
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    return Scale(low, max(high, low + 1), range(low, max(high, low + 1) + 1))


def _round_step(step: float) -> float:
    size = 10.0 ** math.floor(math.log10(step))
    return next(factor * size for factor in (1, 2, 2.5, 5, 10) if factor * size >= step * (1 - 1e-9))


def _across(scale: Scale, value: float) -> float:
    return _MARGIN + (_ROW_WIDTH - 2 * _MARGIN) * scale.at(value)


def _anchor(scale: Scale, tick: float) -> str:
    return "start" if tick == scale.ticks[0] else "end" if tick == scale.ticks[-1] else "middle"


def _grid(scale: Scale) -> str:
    lines = "".join(f"M{_across(scale, tick):.1f} 0V{_ROW_HEIGHT}" for tick in scale.ticks)
    zero = _across(scale, 0.0)
    strong = f'<path class="zero" d="M{zero:.1f} 0V{_ROW_HEIGHT}"/>' if scale.low < 0 < scale.high else ""
    return f'<path class="grid" d="{lines}"/>{strong}'


def _upwards(scale: Scale) -> str:
    floor = _HEIGHT - _BOTTOM
    shapes = []
    for tick in scale.ticks:
        y = floor - (floor - _TOP) * scale.at(tick)
        unit = " %" if scale.percent else ""
        shapes.append(f'<path class="grid" d="M{_LEFT} {y:.1f}H{_WIDTH - _RIGHT}"/>')
        shapes.append(f'<text x="{_LEFT - 6}" y="{y + 3.5:.1f}" text-anchor="end">{scale.label(tick)}{unit}</text>')
    return "".join(shapes)


def _below(label: str) -> str:
    return (
        f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{_HEIGHT - 5}" text-anchor="middle">{markup.text(label)}</text>'
    )


def _svg(width: int, height: int, content: str, title: str) -> str:
    told = f'role="img">{_title(title)}' if title else 'aria-hidden="true">'
    return f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" {told}{content}</svg>'


def _title(text: str) -> str:
    return f"<title>{markup.text(text)}</title>"
