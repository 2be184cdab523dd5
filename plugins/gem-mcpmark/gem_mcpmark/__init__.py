"""PostgreSQL tasks of MCPMark, and a sample of our own: a plugin of GEM."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_mcpmark.env import PostgresEnv
    from gem_mcpmark.errors import PostgresError, TaskError
    from gem_mcpmark.tasks import Task, read_tasks

_MODULES = {
    "PostgresEnv": "env",
    "PostgresError": "errors",
    "Task": "tasks",
    "TaskError": "errors",
    "read_tasks": "tasks",
}

__all__ = ["PostgresEnv", "PostgresError", "Task", "TaskError", "read_tasks"]


def __getattr__(name: str) -> Any:
    # Resolved on first use: listing the environments imports this package and must not load psycopg.
    if name in _MODULES:
        return getattr(importlib.import_module(f"gem_mcpmark.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'gem_mcpmark' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
