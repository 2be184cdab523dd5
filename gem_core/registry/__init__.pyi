"""The public names, which are imported on first use."""

from .entry_points import load_entry_point as load_entry_point
from .hookspecs import hookimpl as hookimpl
from .lookup import Registry as Registry, registry as registry
from .requirements import RequirementStatus as RequirementStatus
from .specs import (
    AgentSpec as AgentSpec,
    CallFormatSpec as CallFormatSpec,
    CommandSpec as CommandSpec,
    EnvSpec as EnvSpec,
    RequirementSpec as RequirementSpec,
    ToolSpec as ToolSpec,
    VectorBackendSpec as VectorBackendSpec,
    WrapperSpec as WrapperSpec,
)
