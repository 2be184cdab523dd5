"""GEM: a gym for language-model agents.

An environment is a task plus optional tools; an agent's whole response is one action; every turn has its own reward::

    import gem_core as gem

    env = gem.make("game:GuessTheNumber-v0")
    observation, info = env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(env.sample_random_action())

Names are resolved on first use, so that ``import gem_core`` loads nothing heavy.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gem_core.dataset import DatasetEnv, Grade
    from gem_core.env import AsyncEnv, Env
    from gem_core.episodes import Episode, Transition, read_episodes, write_episodes
    from gem_core.errors import GemError
    from gem_core.hookspecs import hookimpl
    from gem_core.parsing import extract_code_blocks, extract_last_boxed_answer, extract_last_tagged_answer
    from gem_core.plans import PlanItem
    from gem_core.registry import list_envs, make, make_vec, print_envs, register, spec
    from gem_core.rollouts import arollout, rollout
    from gem_core.specs import AgentSpec, CommandSpec, EnvSpec, ToolSpec, VectorBackendSpec, WrapperSpec
    from gem_core.tool_env import ToolEnv
    from gem_core.tools import Tool, ToolCall, ToolResult
    from gem_core.types import TERMINAL_STATE, Observation, Response
    from gem_core.vector.env import VectorEnv
    from gem_core.wrapper import Wrapper

__version__ = "0.1.0"

_HOME = {
    "dataset": ("DatasetEnv", "Grade"),
    "env": ("AsyncEnv", "Env"),
    "episodes": ("Episode", "Transition", "read_episodes", "write_episodes"),
    "errors": ("GemError",),
    "hookspecs": ("hookimpl",),
    "parsing": ("extract_code_blocks", "extract_last_boxed_answer", "extract_last_tagged_answer"),
    "plans": ("PlanItem",),
    "registry": ("list_envs", "make", "make_vec", "print_envs", "register", "spec"),
    "rollouts": ("arollout", "rollout"),
    "specs": ("AgentSpec", "CommandSpec", "EnvSpec", "ToolSpec", "VectorBackendSpec", "WrapperSpec"),
    "tool_env": ("ToolEnv",),
    "tools": ("Tool", "ToolCall", "ToolResult"),
    "types": ("TERMINAL_STATE", "Observation", "Response"),
    "vector.env": ("VectorEnv",),
    "wrapper": ("Wrapper",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "TERMINAL_STATE",
    "AgentSpec",
    "AsyncEnv",
    "CommandSpec",
    "DatasetEnv",
    "Env",
    "EnvSpec",
    "Episode",
    "GemError",
    "Grade",
    "Observation",
    "PlanItem",
    "Response",
    "Tool",
    "ToolCall",
    "ToolEnv",
    "ToolResult",
    "ToolSpec",
    "Transition",
    "VectorBackendSpec",
    "VectorEnv",
    "Wrapper",
    "WrapperSpec",
    "__version__",
    "arollout",
    "extract_code_blocks",
    "extract_last_boxed_answer",
    "extract_last_tagged_answer",
    "hookimpl",
    "list_envs",
    "make",
    "make_vec",
    "print_envs",
    "read_episodes",
    "register",
    "rollout",
    "spec",
    "write_episodes",
]


def __getattr__(name: str) -> Any:
    module = _MODULE_OF.get(name)
    if module is None:
        raise AttributeError(f"module 'gem_core' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"gem_core.{module}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
