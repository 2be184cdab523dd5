"""What a training run leaves behind: ``metrics.jsonl``, TensorBoard, Weights & Biases, curves and pages.

Names are imported on first use, so that a log is written without loading matplotlib.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_train.reporting.curves import plot_run
    from gem_train.reporting.figures import Bar, Curve, bars_with_intervals, curves_with_bands, first_guesses
    from gem_train.reporting.intervals import Interval, mean_interval
    from gem_train.reporting.metrics import MetricsLog, read_metrics, truncate_jsonl
    from gem_train.reporting.pages import write_page, write_study_page

_HOME = {
    "curves": ("plot_run",),
    "figures": ("Bar", "Curve", "bars_with_intervals", "curves_with_bands", "first_guesses"),
    "intervals": ("Interval", "mean_interval"),
    "metrics": ("MetricsLog", "read_metrics", "truncate_jsonl"),
    "pages": ("write_page", "write_study_page"),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "Bar",
    "Curve",
    "Interval",
    "MetricsLog",
    "bars_with_intervals",
    "curves_with_bands",
    "first_guesses",
    "mean_interval",
    "plot_run",
    "read_metrics",
    "truncate_jsonl",
    "write_page",
    "write_study_page",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
