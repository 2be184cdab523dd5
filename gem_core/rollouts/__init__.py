"""Rollouts: agents, the loop in which they act in environments, and resuming a stopped run."""

from gem_core.rollouts.agent import (
    READS,
    Agent,
    AgentTraits,
    Context,
    as_agent,
    close_agent,
    current_folder_importable,
    is_asynchronous,
    load_agent,
    load_agents,
    prepare_agent,
)
from gem_core.rollouts.drivers import arollout, default_plan, rollout
from gem_core.rollouts.one_seat import SingleAgentEnv, single_agent
from gem_core.rollouts.resume import FinishedEpisodes
from gem_core.rollouts.seat import new_episode
from gem_core.rollouts.seating import League, Seated, Seating, as_seating

__all__ = [
    "READS",
    "Agent",
    "AgentTraits",
    "Context",
    "FinishedEpisodes",
    "League",
    "Seated",
    "Seating",
    "SingleAgentEnv",
    "arollout",
    "as_agent",
    "as_seating",
    "close_agent",
    "current_folder_importable",
    "default_plan",
    "is_asynchronous",
    "load_agent",
    "load_agents",
    "new_episode",
    "prepare_agent",
    "rollout",
    "single_agent",
]
