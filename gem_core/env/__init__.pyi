"""The public names, which are imported on first use."""

from .agent_selector import AgentSelector as AgentSelector
from .base import AsyncEnv as AsyncEnv, Env as Env
from .checks import Verdict as Verdict, checked_reset as checked_reset, checked_result as checked_result
from .guard import Guard as Guard
from .multi_agent import MultiAgentEnv as MultiAgentEnv
from .observations import (
    is_messages as is_messages,
    join_observations as join_observations,
    observation_from as observation_from,
    texts_of as texts_of,
)
from .seats import SeatWrappers as SeatWrappers
from .seeding import stable_hash as stable_hash
from .spaces import Content as Content, Messages as Messages, Text as Text
from .wrapper import (
    AnyEnv as AnyEnv,
    Wrapper as Wrapper,
    concurrency_of as concurrency_of,
    reset_async as reset_async,
    step_async as step_async,
)
