"""Figures of studies: each function draws plain data into a PNG, and returns the same figure as markup for a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gem_train.reporting import drawing, markup

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Bar(NamedTuple):
    """A mean and its interval.

    Args:
        label: What was measured.
        mean: Its mean.
        low: Lower end of the interval; None where it is not known.
        high: Upper end.
    """

    label: str
    mean: float
    low: float | None = None
    high: float | None = None


class Curve(NamedTuple):
    """A mean over steps and its band.

    Args:
        steps: Numbers of updates, in ascending order.
        mean: The mean at each.
        low: Lower end of the interval at each, None or NaN where it is not known; an empty sequence for no band.
        high: Upper end at each.
    """

    steps: Sequence[float]
    mean: Sequence[float]
    low: Sequence[float | None] = ()
    high: Sequence[float | None] = ()


def bars_with_intervals(
    rows: Sequence[Bar], path: str | Path, *, unit: str, optimum: float | None = None, percent: bool = False
) -> str:
    """Draw means as points with the bars of their intervals, a row each, the first at the top.

    The axis need not begin at 0: what differs by a few percent is to be seen to differ.

    Args:
        rows: What was measured.
        path: Where the PNG goes.
        unit: What stands below, as "mean turns".
        optimum: The best value that there can be, drawn as a line through all rows; None for no line.
        percent: Whether values are shares, shown in percent.
    """

    def draw(axes: Axes) -> None:
        for place, row in enumerate(rows):
            colour = drawing.series_colour(place)
            if row.low is not None and row.high is not None:
                axes.hlines(place, row.low, row.high, color=colour, linewidth=2)
                axes.plot([row.low, row.high], [place, place], "|", color=colour, markersize=9, markeredgewidth=2)
            axes.plot(row.mean, place, "o", color=colour, markersize=6)
            shown = drawing.number_text(float(f"{row.mean:.3g}"), percent=percent)
            axes.text(1.03, place, shown, transform=axes.get_yaxis_transform(), va="center_baseline")
        if optimum is not None:
            axes.axvline(optimum, color=drawing.INK, linestyle="--", linewidth=1)
            axes.text(optimum, 1.02, "optimum", transform=axes.get_xaxis_transform(), ha="center")
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_yticks(range(len(rows)), [row.label for row in rows], color=drawing.INK)
        axes.margins(x=0.08)
        axes.set_xlabel(unit)
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)
        axes.xaxis.set_major_formatter(drawing.number_formatter(percent=percent))
        axes.tick_params(length=0)

    figure = drawing.panel_figure(draw, 0.8 + 0.27 * len(rows))
    drawing.save_png(figure, path)
    return drawing.svg_text(figure, f"{unit}, with intervals")


def curves_with_bands(
    series: Mapping[str, Mapping[str, Curve]],
    path: str | Path,
    *,
    unit: str,
    optimum: Mapping[str, float] | None = None,
    percent: bool = False,
) -> str:
    """Draw means over updates with the bands of their intervals, in a panel for each task.

    Args:
        series: For each task the curves by name; a name has one colour in all panels.
        path: Where the PNG goes.
        unit: What stands left of each panel, as "success".
        optimum: The best value that there can be in a task, drawn as a dashed line.
        percent: Whether values are shares, shown in percent.
    """
    names = list(dict.fromkeys(name for curves in series.values() for name in curves))
    keys = [drawing.Key(name, number) for number, name in enumerate(names)]

    def panel(task: str) -> drawing.DrawPanel:
        def draw(axes: Axes) -> None:
            for name, curve in series[task].items():
                colour = drawing.series_colour(names.index(name))
                if len(curve.low):
                    low, high = (np.array(end, dtype=np.float64) for end in (curve.low, curve.high))
                    axes.fill_between(curve.steps, low, high, color=colour, alpha=0.2, linewidth=0)
                axes.plot(curve.steps, curve.mean, color=colour, marker="" if len(curve.steps) > 1 else "o")
            if optimum and task in optimum:
                axes.axhline(optimum[task], color=drawing.INK, linestyle="--", linewidth=1)
            axes.set_title(task)
            axes.set_xlabel("update")
            axes.set_ylabel(unit)
            drawing.label_numbers(axes, percent=percent)

        return draw

    panels = {task: panel(task) for task in series}
    drawing.save_png(drawing.grid_figure(list(panels.values()), keys), path)
    drawn = [
        drawing.svg_text(drawing.panel_figure(draw), f"{unit} over updates, {task}") for task, draw in panels.items()
    ]
    return markup.panels(drawn, keys)


def first_guesses(table: Sequence[Sequence[float]], path: str | Path) -> str:
    """Draw how often each number was guessed in the first turns, with bisection's own guesses marked.

    Args:
        table: For each turn how often 1, 2, 3, ... were guessed, as counts or shares.
        path: Where the PNG goes.
    """
    counts = np.array(table, dtype=np.float64)
    turns, numbers = counts.shape
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1e-12)

    def draw(turn: int) -> drawing.DrawPanel:
        def draw_turn(axes: Axes) -> None:
            axes.bar(np.arange(1, numbers + 1), shares[turn], width=0.85, color=drawing.series_colour(0))
            marked = bisection_guesses(numbers, turn + 1)
            colour = drawing.series_colour(1)
            above = axes.get_xaxis_transform()
            axes.plot(marked, [0.95] * len(marked), color=colour, transform=above, **drawing.TRIANGLE)
            axes.set_title(f"Guess {turn + 1}")
            axes.set_xlabel("number guessed")
            axes.set_ylim(0, 1.2 * (shares[turn].max() or 1.0))
            axes.set_xlim(0, numbers + 1)
            axes.grid(visible=False, axis="x")
            drawing.label_numbers(axes, percent=True)

        return draw_turn

    keys = [drawing.Key("share of guesses", 0, "area"), drawing.Key("bisection's guesses", 1, "triangle")]
    drawing.save_png(drawing.grid_figure([draw(turn) for turn in range(turns)], keys), path)
    drawn = [
        drawing.svg_text(drawing.panel_figure(draw(turn)), f"numbers guessed in turn {turn + 1}")
        for turn in range(turns)
    ]
    return markup.panels(drawn, keys)


def bisection_guesses(numbers: int, turn: int) -> list[int]:
    """Return what bisection of 1 to ``numbers`` may guess in a turn, counted from 1: the lower middles."""
    ranges = [(1, numbers)]
    for _ in range(turn - 1):
        halves = [
            half for low, high in ranges for half in ((low, (low + high) // 2 - 1), ((low + high) // 2 + 1, high))
        ]
        ranges = [(low, high) for low, high in halves if low <= high]
    return [(low + high) // 2 for low, high in ranges]
