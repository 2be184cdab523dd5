r"""Python for agents: a pool of warm sandboxes, and the tool ``python`` on top of it.

The pool is there for other plugins too::

    from gem_tools.python import Limits, shared_pool

    outcome = shared_pool().run("print(int(input()) + 1)", stdin="41", limits=Limits(wall_s=2))
    outcome.status, outcome.stdout  # ("ok", "42\n")
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from gem_core.errors import refuse_windows

if TYPE_CHECKING:
    from gem_tools.python.errors import SandboxError
    from gem_tools.python.limits import Limits
    from gem_tools.python.outcome import Outcome
    from gem_tools.python.pool import Pool, Session, shared_pool
    from gem_tools.python.tool import PythonTool, make_python

refuse_windows("the tool 'python'")

__all__ = ["Limits", "Outcome", "Pool", "PythonTool", "SandboxError", "Session", "make_python", "shared_pool"]

_HOMES = {
    "Limits": "limits",
    "Outcome": "outcome",
    "Pool": "pool",
    "PythonTool": "tool",
    "SandboxError": "errors",
    "Session": "pool",
    "make_python": "tool",
    "shared_pool": "pool",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
