"""Evaluation of agents and environments: a plugin of GEM."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_eval.auditing.audit import audit

__all__ = ["audit"]

_WHERE = {"audit": "gem_eval.auditing.audit"}


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_WHERE[name]), name)
