"""What a training run leaves behind: ``metrics.jsonl``, TensorBoard, Weights & Biases, curves and pages.

Names are imported on first use, so that a log is written without loading matplotlib.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_train.reporting.metrics import MetricsLog, read_metrics, truncate_jsonl

__all__ = ["MetricsLog", "read_metrics", "truncate_jsonl"]

_HOME = {"MetricsLog": "metrics", "read_metrics": "metrics", "truncate_jsonl": "metrics"}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
