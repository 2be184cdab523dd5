"""The environment interface: ``Env``, ``Wrapper``, the guard around a task, spaces, and seeding."""

from __future__ import annotations

from gem_core.env.agent_selector import AgentSelector
from gem_core.env.base import AsyncEnv, Env
from gem_core.env.checks import Verdict, checked_reset, checked_result
from gem_core.env.guard import Guard
from gem_core.env.multi_agent import MultiAgentEnv
from gem_core.env.observations import is_messages, join_observations, observation_from, texts_of
from gem_core.env.seats import SeatWrappers
from gem_core.env.seeding import stable_hash
from gem_core.env.spaces import Content, Messages, Text
from gem_core.env.wrapper import AnyEnv, Wrapper, concurrency_of, reset_async, step_async

__all__ = [
    "AgentSelector",
    "AnyEnv",
    "AsyncEnv",
    "Content",
    "Env",
    "Guard",
    "Messages",
    "MultiAgentEnv",
    "SeatWrappers",
    "Text",
    "Verdict",
    "Wrapper",
    "checked_reset",
    "checked_result",
    "concurrency_of",
    "is_messages",
    "join_observations",
    "observation_from",
    "reset_async",
    "stable_hash",
    "step_async",
    "texts_of",
]
