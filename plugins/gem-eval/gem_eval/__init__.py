"""Score models on environments, and read, compare and trust the result; see ``docs/evaluation.md``."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_eval.auditing.audit import audit
    from gem_eval.records import Row, Run, open_run
    from gem_eval.running.evaluation import evaluate
    from gem_eval.running.limits import Limits
    from gem_eval.scores import Score, compute_scores
    from gem_eval.suites import Model, Suite, load_suite

__all__ = [
    "Limits",
    "Model",
    "Row",
    "Run",
    "Score",
    "Suite",
    "audit",
    "compute_scores",
    "evaluate",
    "load_suite",
    "open_run",
]

_HOME = {
    "Limits": "running.limits",
    "Model": "suites",
    "Row": "records",
    "Run": "records",
    "Score": "scores",
    "Suite": "suites",
    "audit": "auditing.audit",
    "compute_scores": "scores",
    "evaluate": "running.evaluation",
    "load_suite": "suites",
    "open_run": "records",
}
"""Where the public names come from; they are imported on first use."""


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
