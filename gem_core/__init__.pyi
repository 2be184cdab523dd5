"""The public names, which are imported on first use."""

from .api import (
    list_envs as list_envs,
    make as make,
    make_vec as make_vec,
    print_envs as print_envs,
    register as register,
    spec as spec,
)
from .data.dataset import DatasetEnv as DatasetEnv, Grade as Grade
from .env.agent_selector import AgentSelector as AgentSelector
from .env.base import AsyncEnv as AsyncEnv, Env as Env
from .env.multi_agent import MultiAgentEnv as MultiAgentEnv
from .env.wrapper import Wrapper as Wrapper
from .errors import GemError as GemError
from .parsing import (
    extract_code_blocks as extract_code_blocks,
    extract_last_boxed_answer as extract_last_boxed_answer,
    extract_last_tagged_answer as extract_last_tagged_answer,
)
from .records.episode import Episode as Episode, Transition as Transition
from .records.files import (
    read_episodes as read_episodes,
    read_records as read_records,
    write_episodes as write_episodes,
)
from .records.joint import JointEpisode as JointEpisode
from .records.plans import PlanItem as PlanItem
from .registry.hookspecs import hookimpl as hookimpl
from .registry.requirements import RequirementStatus as RequirementStatus
from .registry.specs import (
    AgentSpec as AgentSpec,
    CallFormatSpec as CallFormatSpec,
    CommandSpec as CommandSpec,
    EnvSpec as EnvSpec,
    RequirementSpec as RequirementSpec,
    ToolSpec as ToolSpec,
    VectorBackendSpec as VectorBackendSpec,
    WrapperSpec as WrapperSpec,
)
from .rollouts.drivers import arollout as arollout, rollout as rollout
from .rollouts.one_seat import single_agent as single_agent
from .rollouts.seating import League as League
from .tools.env import ToolEnv as ToolEnv
from .tools.tool import Tool as Tool, ToolCall as ToolCall, ToolResult as ToolResult
from .types import TERMINAL_STATE as TERMINAL_STATE, Observation as Observation, Response as Response
from .vector.vector_env import VectorEnv as VectorEnv

__version__: str
