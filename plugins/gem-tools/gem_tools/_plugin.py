"""What this distribution offers; it imports no tool."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.registry import CallFormatSpec, CommandSpec, RequirementSpec, ToolSpec, hookimpl
from gem_tools.call_formats.table import call_formats


@hookimpl
def gem_register_tools() -> Iterable[ToolSpec]:
    """The tools; each entry point takes the tool's options by keyword."""
    yield ToolSpec(
        name="python",
        entry_point="gem_tools.python.tool:make_python",
        summary="Runs Python code in a sandbox, each call anew or with its variables kept.",
        status="gem_tools.python.status:status",
    )
    yield ToolSpec(
        name="search",
        entry_point="gem_tools.search.tool:make_search",
        summary="Searches a local corpus, a retrieval server, or the web.",
        status="gem_tools.search.status:status",
    )
    yield ToolSpec(
        name="mcp",
        entry_point="gem_tools.mcp.tool:make_mcp",
        summary="The tools of any MCP server, or of all in a configuration file.",
        status="gem_tools.mcp.command:status",
    )


@hookimpl
def gem_register_call_formats() -> Iterable[CallFormatSpec]:
    """The forms in which model families call tools."""
    return call_formats()


@hookimpl
def gem_register_requirements() -> Iterable[RequirementSpec]:
    """What the sandboxes stand on."""
    engine, sandbox = "gem_tools.container_engine:probe", "gem_tools.requirements:bubblewrap"
    yield RequirementSpec(name="docker", entry_point=engine, summary="A container engine that answers.")
    yield RequirementSpec(name="bubblewrap", entry_point=sandbox, summary="A sandbox that starts.")


@hookimpl
def gem_add_commands() -> Iterable[CommandSpec]:
    """The commands."""
    yield CommandSpec(
        name="serve-search",
        entry_point="gem_tools.search.serve_command:command",
        summary="Serve a corpus to many trainers, in the form of Search-R1's server.",
    )
    yield CommandSpec(
        name="mcp",
        entry_point="gem_tools.mcp.command:command",
        summary="Show what MCP servers offer, and what is wrong with them.",
    )
