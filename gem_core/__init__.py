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
    from gem_core.api import list_envs, make, make_vec, print_envs, register, spec
    from gem_core.data.dataset import DatasetEnv, Grade
    from gem_core.env.agent_selector import AgentSelector
    from gem_core.env.base import AsyncEnv, Env
    from gem_core.env.multi_agent import MultiAgentEnv
    from gem_core.env.wrapper import Wrapper
    from gem_core.errors import GemError
    from gem_core.parsing import extract_code_blocks, extract_last_boxed_answer, extract_last_tagged_answer
    from gem_core.records.episode import Episode, Transition
    from gem_core.records.files import read_episodes, read_records, write_episodes
    from gem_core.records.joint import JointEpisode
    from gem_core.records.plans import PlanItem
    from gem_core.registry.hookspecs import hookimpl
    from gem_core.registry.requirements import RequirementStatus
    from gem_core.registry.specs import (
        AgentSpec,
        CallFormatSpec,
        CommandSpec,
        EnvSpec,
        RequirementSpec,
        ToolSpec,
        VectorBackendSpec,
        WrapperSpec,
    )
    from gem_core.rollouts.drivers import arollout, rollout
    from gem_core.rollouts.one_seat import single_agent
    from gem_core.rollouts.seating import League
    from gem_core.tools.env import ToolEnv
    from gem_core.tools.tool import Tool, ToolCall, ToolResult
    from gem_core.types import TERMINAL_STATE, Observation, Response
    from gem_core.vector.vector_env import VectorEnv

__version__ = "0.1.0"

_HOME = {
    "data.dataset": ("DatasetEnv", "Grade"),
    "env.agent_selector": ("AgentSelector",),
    "env.base": ("AsyncEnv", "Env"),
    "env.multi_agent": ("MultiAgentEnv",),
    "records.episode": ("Episode", "Transition"),
    "records.files": ("read_episodes", "read_records", "write_episodes"),
    "records.joint": ("JointEpisode",),
    "errors": ("GemError",),
    "registry.hookspecs": ("hookimpl",),
    "parsing": ("extract_code_blocks", "extract_last_boxed_answer", "extract_last_tagged_answer"),
    "records.plans": ("PlanItem",),
    "api": ("list_envs", "make", "make_vec", "print_envs", "register", "spec"),
    "rollouts.drivers": ("arollout", "rollout"),
    "rollouts.one_seat": ("single_agent",),
    "rollouts.seating": ("League",),
    "registry.requirements": ("RequirementStatus",),
    "registry.specs": (
        "AgentSpec",
        "CallFormatSpec",
        "CommandSpec",
        "EnvSpec",
        "RequirementSpec",
        "ToolSpec",
        "VectorBackendSpec",
        "WrapperSpec",
    ),
    "tools.env": ("ToolEnv",),
    "tools.tool": ("Tool", "ToolCall", "ToolResult"),
    "types": ("TERMINAL_STATE", "Observation", "Response"),
    "vector.vector_env": ("VectorEnv",),
    "env.wrapper": ("Wrapper",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "TERMINAL_STATE",
    "AgentSelector",
    "AgentSpec",
    "AsyncEnv",
    "CallFormatSpec",
    "CommandSpec",
    "DatasetEnv",
    "Env",
    "EnvSpec",
    "Episode",
    "GemError",
    "Grade",
    "JointEpisode",
    "League",
    "MultiAgentEnv",
    "Observation",
    "PlanItem",
    "RequirementSpec",
    "RequirementStatus",
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
    "read_records",
    "register",
    "rollout",
    "single_agent",
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
