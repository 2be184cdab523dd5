"""Score models on environments, and read, compare and trust the result; see ``docs/evaluation.md``."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_eval.auditing.audit import audit
    from gem_eval.comparing.comparison import compare
    from gem_eval.exporting.tables import to_pandas
    from gem_eval.records import Row, Run, open_run
    from gem_eval.replaying.replay import replay
    from gem_eval.running.evaluation import evaluate
    from gem_eval.running.limits import Limits
    from gem_eval.scores import RowScore, Score, compute_row_scores, compute_scores
    from gem_eval.scoring.grading import score
    from gem_eval.suites import Model, Suite, load_suite

__all__ = [
    "Limits",
    "Model",
    "Row",
    "RowScore",
    "Run",
    "Score",
    "Suite",
    "audit",
    "compare",
    "compute_row_scores",
    "compute_scores",
    "evaluate",
    "load_suite",
    "open_run",
    "replay",
    "score",
    "to_pandas",
]

_HOME = {
    "Limits": "running.limits",
    "Model": "suites",
    "Row": "records",
    "RowScore": "scores",
    "Run": "records",
    "Score": "scores",
    "Suite": "suites",
    "audit": "auditing.audit",
    "compare": "comparing.comparison",
    "compute_row_scores": "scores",
    "compute_scores": "scores",
    "evaluate": "running.evaluation",
    "load_suite": "suites",
    "open_run": "records",
    "replay": "replaying.replay",
    "score": "scoring.grading",
    "to_pandas": "exporting.tables",
}
"""Where the public names come from; they are imported on first use."""


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
