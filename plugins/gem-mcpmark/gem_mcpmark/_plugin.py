"""What this distribution offers; it imports no environment and no database driver."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry import EnvSpec, RequirementSpec, hookimpl

_ENTRY = "gem_mcpmark.env:PostgresEnv"
_NEEDS = ("package:gem-mcpmark[postgres]", "postgres")
_TAGS = ("mcp", "postgres", "tools", "text")


@hookimpl
def gem_register_envs() -> Iterable[EnvSpec]:
    """The sample, and any folder of MCPMark's tasks."""
    yield EnvSpec(
        id="mcp:Sample",
        entry_point=_ENTRY,
        summary="Eight tasks on the PostgreSQL database of a tool library, by MCP tools; works offline.",
        kwargs={"path": "gem_mcpmark:sample"},
        tags=_TAGS,
        requires=_NEEDS,
        deterministic=False,
    )
    yield EnvSpec(
        id="mcp:Postgres",
        entry_point=_ENTRY,
        summary="PostgreSQL tasks of MCPMark, by MCP tools, in a folder of yours (path=…).",
        tags=_TAGS,
        requires=("argument:path", *_NEEDS),
        deterministic=False,
        folder_markers=("verify.py",),
    )


@hookimpl
def gem_register_requirements() -> Iterable[RequirementSpec]:
    """What the databases stand on."""
    yield RequirementSpec(
        name="postgres",
        entry_point="gem_mcpmark.requirements:postgres",
        summary="A PostgreSQL that is named, or whose programs are installed.",
    )
