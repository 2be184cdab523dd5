"""The public names, which are imported on first use."""

from .agent import (
    READS as READS,
    Agent as Agent,
    AgentTraits as AgentTraits,
    Context as Context,
    as_agent as as_agent,
    close_agent as close_agent,
    current_folder_importable as current_folder_importable,
    is_asynchronous as is_asynchronous,
    load_agent as load_agent,
    load_agents as load_agents,
    prepare_agent as prepare_agent,
)
from .drivers import arollout as arollout, default_plan as default_plan, rollout as rollout
from .one_seat import SingleAgentEnv as SingleAgentEnv, single_agent as single_agent
from .resume import FinishedEpisodes as FinishedEpisodes
from .seat import new_episode as new_episode
from .seating import League as League, Seated as Seated, Seating as Seating, as_seating as as_seating
