"""The registry: records that plugins offer, the loader of plugins, and look-up by name."""

from __future__ import annotations

from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.hookspecs import hookimpl
from gem_core.registry.lookup import Registry, registry
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

__all__ = [
    "AgentSpec",
    "CallFormatSpec",
    "CommandSpec",
    "EnvSpec",
    "Registry",
    "RequirementSpec",
    "RequirementStatus",
    "ToolSpec",
    "VectorBackendSpec",
    "WrapperSpec",
    "hookimpl",
    "load_entry_point",
    "registry",
]
