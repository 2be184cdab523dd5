"""Evaluation for GEM: runs and their episodes, as commands and as Python functions.

Names are resolved on first use, so that the commands start quickly.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_eval.exporting.tables import to_pandas
    from gem_eval.records import open_run

__all__ = ["open_run", "to_pandas"]

_HOMES = {"open_run": "gem_eval.records", "to_pandas": "gem_eval.exporting.tables"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gem_eval' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
