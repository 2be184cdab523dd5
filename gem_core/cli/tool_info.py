"""What ``gem info`` and ``gem list`` say of tools and other things that have a short name."""

from __future__ import annotations

import inspect
import json
from typing import Any

import click

from gem_core.errors import GemError
from gem_core.registry import registry
from gem_core.specs import AgentSpec, NamedSpec, ToolSpec, VectorBackendSpec, WrapperSpec

KINDS: dict[str, type[NamedSpec]] = {
    "tools": ToolSpec,
    "wrappers": WrapperSpec,
    "agents": AgentSpec,
    "backends": VectorBackendSpec,
}
"""Words for ``gem list`` that are no pattern of ids."""


def find_tool(name: str) -> ToolSpec | None:
    """Return the record of a tool, None for any other name."""
    return next((record for record in registry().named(ToolSpec) if record.name == name), None)


def described(record: NamedSpec) -> dict[str, Any]:
    """Return what is known of a record without importing what it points to."""
    provider = next((plugin for plugin in registry().plugins() if record in plugin.records), None)
    return {
        "name": record.name,
        "summary": record.summary,
        "entry_point": record.entry_point if isinstance(record.entry_point, str) else repr(record.entry_point),
        "distribution": None if provider is None else provider.distribution,
    }


def print_tool(record: ToolSpec, as_json: bool) -> None:
    """Describe a tool: its options, and what an agent is told of it."""
    from gem_core.arguments import signature_of
    from gem_core.entry_points import load_entry_point
    from gem_core.tool_choices import tools_by_name

    facts = described(record)
    maker = load_entry_point(record.entry_point, f"tool {record.name!r}")
    signature = signature_of(maker)
    options = [] if signature is None else [_option(option) for option in signature.parameters.values()]
    problem, tools = None, {}
    try:
        tools = tools_by_name([record.name])
    except GemError as error:  # it may need options, a key or a server; all else can be told without
        problem = str(error)
    if as_json:
        shown = {"options": options, "schemas": [tool.schema() for tool in tools.values()], "problem": problem}
        click.echo(json.dumps({**facts, **shown}, indent=1))
        return
    click.echo(click.style(record.name, bold=True) + (f" · {record.summary}" if record.summary else ""))
    lines = [
        ("options", ", ".join(options) or "none"),
        ("offered by", str(facts["distribution"])),
        ("entry point", str(facts["entry_point"])),
        ("missing", problem or ""),
    ]
    for label, value in lines:
        if value:
            click.echo(f"  {label + ':':<14}{value}")
    documented = inspect.getdoc(maker)
    if documented:
        click.echo("\n" + documented)
    if tools:
        click.echo(click.style("\nWhat an agent is told, without options:", bold=True))
        for tool in tools.values():
            click.echo(tool.instructions())


def _option(parameter: inspect.Parameter) -> str:
    return parameter.name if parameter.default is parameter.empty else f"{parameter.name}={parameter.default!r}"
