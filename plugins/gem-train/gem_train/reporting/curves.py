"""The curves of a run: its metrics over its updates, each raw and smoothed, with its evaluations as points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from gem_train.reporting import drawing
from gem_train.reporting.metrics import read_metrics

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Metrics = Sequence[dict[str, float | None]]

MOST_POINTS = 1_000
"""Of a longer run every n-th update is drawn, so that a page stays small."""


class Shown(NamedTuple):
    """How a metric is shown.

    Args:
        name: As in ``metrics.jsonl``.
        title: What stands above its panel, with the unit.
        percent: Whether it is a share, shown in percent.
    """

    name: str
    title: str
    percent: bool = False


SHOWN = (
    Shown("return", "Return"),
    Shown("success", "Success", percent=True),
    Shown("turns", "Turns per episode"),
    Shown("response_tokens", "Tokens per response"),
    Shown("loss", "Loss"),
    Shown("entropy", "Entropy (nats per token)"),
    Shown("kl", "KL divergence (nats per token)"),
)


class Points(NamedTuple):
    """A metric over the updates at which it is known.

    Args:
        updates: Numbers of updates, in ascending order.
        values: The metric.
    """

    updates: npt.NDArray[np.float64]
    values: npt.NDArray[np.float64]


def plot_run(folder: str | Path) -> Path:
    """Draw the metrics of a run into ``folder/curves.png``, and return its path."""
    metrics = read_metrics(folder)
    panels = [_panel(metrics, shown) for shown in shown_metrics(metrics) or SHOWN[:1]]
    return drawing.save_png(drawing.grid_figure(panels, run_legend(metrics)), Path(folder) / "curves.png")


def run_legend(metrics: Metrics) -> list[drawing.Key]:
    """Return what the lines and points of a run's curves are."""
    width = smoothing_width(len(metrics))
    lines = [drawing.Key("one update", 0, "faint"), drawing.Key(f"mean of {width} updates", 0)]
    found = enumerate(evaluations(metrics), start=1)
    return [*(lines if width > 1 else []), *(drawing.Key(name, number, "point") for number, name in found)]


def run_panels(metrics: Metrics) -> list[str]:
    """Return the curves of a run as ``<svg>`` elements, one a metric."""
    return [
        drawing.svg_text(drawing.panel_figure(_panel(metrics, shown)), f"{shown.title} over updates")
        for shown in shown_metrics(metrics)
    ]


def shown_metrics(metrics: Metrics) -> list[Shown]:
    """Return those of the metrics that have a panel, in the order in which they are shown."""
    names = {name.rpartition("/")[2] if name.startswith("eval/") else name for line in metrics for name in line}
    return [shown for shown in SHOWN if shown.name in names]


def evaluations(metrics: Metrics) -> dict[str, str]:
    """Return the evaluations of a run: a name to show, and what the names of its metrics begin with."""
    names = [name for line in metrics for name in line if name.startswith("eval/")]
    prefixes = dict.fromkeys(f"{name.rpartition('/')[0]}/" for name in names)
    return {prefix.removeprefix("eval/").removesuffix("/") or "evaluation": prefix for prefix in prefixes}


def points(metrics: Metrics, name: str) -> Points:
    """Return a metric where it is known."""
    known = [(line["update"], line[name]) for line in metrics if line.get(name) is not None]
    found: Any = np.array(known, dtype=np.float64).reshape(-1, 2)
    return Points(found[:, 0], found[:, 1])


def smoothed(values: npt.NDArray[np.float64], width: int) -> npt.NDArray[np.float64]:
    """Return the mean of the values around each, ``width`` of them (an odd number), fewer at both ends."""
    places = np.arange(len(values))
    first = np.maximum(places - width // 2, 0)
    end = np.minimum(places + width // 2 + 1, len(values))
    sums = np.concatenate([[0.0], np.cumsum(values)])
    means: npt.NDArray[np.float64] = (sums[end] - sums[first]) / (end - first)
    return means


def smoothing_width(count: int) -> int:
    """Return how many updates a point of the smoothed line is the mean of: 5 % of the run, an odd number."""
    return count // 40 * 2 + 1


def _panel(metrics: Metrics, shown: Shown) -> drawing.DrawPanel:
    def draw(axes: Axes) -> None:
        updates, values = points(metrics, shown.name)
        colour = drawing.series_colour(0)
        stride = -(-len(values) // MOST_POINTS) or 1
        width = smoothing_width(len(metrics))
        if width > 1:
            axes.plot(updates[::stride], values[::stride], color=colour, **drawing.FAINT)
            values = smoothed(values, width)
        axes.plot(updates[::stride], values[::stride], color=colour, marker="" if len(values) > 1 else ".")
        for number, prefix in enumerate(evaluations(metrics).values(), start=1):
            evaluated = points(metrics, f"{prefix}{shown.name}")
            axes.plot(*evaluated, color=drawing.series_colour(number), **drawing.POINT)
        axes.set_title(shown.title)
        axes.set_xlabel("update")
        drawing.label_numbers(axes, percent=shown.percent)

    return draw
