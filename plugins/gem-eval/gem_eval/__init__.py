"""Recorded episodes, listed, compared, graded again and gone on with: a plugin of GEM."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_eval.comparing.comparison import compare
    from gem_eval.records import open_run

__all__ = ["compare", "open_run"]

_HOMES = {"compare": "gem_eval.comparing.comparison", "open_run": "gem_eval.records"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
