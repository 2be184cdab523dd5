"""The curves of a run: its metrics over its updates, each raw and smoothed, with its evaluations as points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from gem_train.reporting.metrics import read_metrics

if TYPE_CHECKING:
    from numpy.typing import NDArray

SHOWN = {
    "return": "Return",
    "success": "Success",
    "turns": "Turns per episode",
    "response_tokens": "Tokens per response",
    "loss": "Loss",
    "entropy": "Entropy (nats per token)",
    "kl": "KL divergence (nats per token)",
}
"""The metrics that have a panel, with its title."""


def plot_run(folder: str | Path) -> Path:
    """Draw the metrics of a run into ``folder/curves.png``, and return its path."""
    metrics = read_metrics(folder)
    names = dict.fromkeys(name for line in metrics for name in line)
    evaluations = dict.fromkeys(name.rpartition("/")[0] for name in names if name.startswith("eval/"))
    shown = [name for name in SHOWN if any(known.rpartition("/")[2] == name for known in names)] or ["return"]
    width = len(metrics) // 40 * 2 + 1  # of the smoothed line: 5 % of the run, an odd number
    rows = -(-len(shown) // 3)
    figure = Figure(figsize=(11, 2.4 * rows), layout="constrained")
    for place, name in enumerate(shown, start=1):
        axes = figure.add_subplot(rows, 3, place, title=SHOWN[name], xlabel="update")
        updates, values = _points(metrics, name)
        axes.plot(updates, values, color="C0", alpha=0.35, linewidth=0.8, marker=".", markersize=1, label="one update")
        axes.plot(updates, _smoothed(values, width), color="C0", label=f"mean of {width}")
        for number, prefix in enumerate(evaluations, start=1):
            axes.plot(*_points(metrics, f"{prefix}/{name}"), "o", color=f"C{number % 10}", markersize=4, label=prefix)
        if name == "success":
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    figure.axes[0].legend(fontsize="small")
    path = Path(folder) / "curves.png"
    figure.savefig(path, dpi=160)
    return path


def _points(metrics: Sequence[dict[str, float | None]], name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the updates at which a metric is known, and its values."""
    known = [(line["update"], line[name]) for line in metrics if line.get(name) is not None]
    found: Any = np.array(known, dtype=np.float64).reshape(-1, 2)
    return found[:, 0], found[:, 1]


def _smoothed(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Return the mean of the ``width`` values around each, fewer at both ends."""
    half = width // 2
    return np.array([values[max(place - half, 0) : place + half + 1].mean() for place in range(len(values))])
