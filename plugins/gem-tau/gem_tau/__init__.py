"""Customer service with a simulated user: a plugin of GEM, for the tasks of tau-bench and tau2-bench."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_tau.database import Database, changed_records, fork, restore
    from gem_tau.domains import Domain
    from gem_tau.env import TauEnv
    from gem_tau.folders import TaskSet, read_folder
    from gem_tau.heatmap import heat_map
    from gem_tau.rewards import Reward, replay, reward
    from gem_tau.tasks import Action, Task

_MODULES = {
    "Action": "tasks",
    "Database": "database",
    "Domain": "domains",
    "Reward": "rewards",
    "Task": "tasks",
    "TaskSet": "folders",
    "TauEnv": "env",
    "changed_records": "database",
    "fork": "database",
    "heat_map": "heatmap",
    "read_folder": "folders",
    "replay": "rewards",
    "restore": "database",
    "reward": "rewards",
}

__all__ = [
    "Action",
    "Database",
    "Domain",
    "Reward",
    "Task",
    "TaskSet",
    "TauEnv",
    "changed_records",
    "fork",
    "heat_map",
    "read_folder",
    "replay",
    "restore",
    "reward",
]


def __getattr__(name: str) -> Any:
    # Resolved on first use: listing the environments imports this package and must not load pydantic.
    if name in _MODULES:
        return getattr(importlib.import_module(f"gem_tau.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'gem_tau' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
