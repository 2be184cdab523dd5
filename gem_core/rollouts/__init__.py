"""Episodes of an agent in environments: what an agent is, the one loop that asks it, and resuming what was stopped."""

from gem_core.rollouts.agent import (
    READS,
    Agent,
    Context,
    Reading,
    as_agent,
    close_agent,
    current_folder_importable,
    load_agent,
    prepare_agent,
)
from gem_core.rollouts.drivers import arollout, default_plan, rollout
from gem_core.rollouts.loop import new_episode
from gem_core.rollouts.resume import FinishedEpisodes

__all__ = [
    "READS",
    "Agent",
    "Context",
    "FinishedEpisodes",
    "Reading",
    "arollout",
    "as_agent",
    "close_agent",
    "current_folder_importable",
    "default_plan",
    "load_agent",
    "new_episode",
    "prepare_agent",
    "rollout",
]
