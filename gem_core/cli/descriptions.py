"""Descriptions of records for ``gem list`` and ``gem info``."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable
from typing import Any

from gem_core.arguments import signature_of
from gem_core.docs import gallery_page, page_url
from gem_core.errors import GemError
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.known_distributions import KNOWN_DISTRIBUTIONS
from gem_core.registry.lookup import registry
from gem_core.registry.plugins import Record
from gem_core.registry.specs import AgentSpec, EnvSpec, NamedSpec, ToolSpec, VectorBackendSpec, WrapperSpec

_ROLE = re.compile(r"(?::[\w:]+:`|``)([^`]+)`{1,2}")

KINDS: dict[str, type[NamedSpec]] = {
    "tools": ToolSpec,
    "wrappers": WrapperSpec,
    "agents": AgentSpec,
    "backends": VectorBackendSpec,
}
"""Words for ``gem list`` that name a kind of record instead of a pattern of ids."""


def find_named(name: str) -> list[NamedSpec]:
    """Return the tools, wrappers, agents and backends of a name; ``agent:ARGUMENT`` is the agent."""
    head, colon, _ = name.partition(":")
    kinds = [AgentSpec] if colon else list(KINDS.values())
    if colon and any(record.namespace == head for record in registry().envs()):
        return []
    return [record for kind in kinds for record in registry().specs(kind) if record.name == head]


def describe_record(record: Record) -> dict[str, Any]:
    """Describe a record as plain JSON, without importing its entry point."""
    point = record.entry_point
    if isinstance(record, EnvSpec):
        provider = registry().provider(record.id)
        facts: dict[str, Any] = {
            "id": record.id,
            "summary": record.summary,
            "kwargs": json.loads(json.dumps(dict(record.kwargs), default=repr)),
            "seats": list(record.seats),
            "max_turns": record.turn_limit,
            "tags": list(record.tags),
            "requires": list(record.requires),
            "deterministic": record.deterministic,
            "page": page_of(record),
        }
    else:
        provider = next((plugin for plugin in registry().plugins() if record in plugin.records), None)
        facts = {"kind": record.kind, "name": record.name, "summary": record.summary}
    return {
        **facts,
        "entry_point": point if isinstance(point, str) else repr(point),
        "distribution": None if provider is None else provider.distribution,
    }


def page_of(record: EnvSpec) -> str | None:
    """Return the address of an environment's page in the gallery; None if another project offers it."""
    provider = registry().provider(record.id)
    ours = provider is not None and provider.distribution in KNOWN_DISTRIBUTIONS
    return page_url(gallery_page(record.id)) if ours else None


def describe_in_full(record: NamedSpec) -> dict[str, Any]:
    """Describe a record as plain JSON, with the options of its entry point."""
    facts = describe_record(record)
    maker = load_entry_point(record.entry_point, f"{record.kind} {record.name!r}")
    parameters = list((signature_of(maker) or inspect.Signature()).parameters.values())
    if isinstance(record, WrapperSpec | VectorBackendSpec):
        parameters = parameters[1:]  # the environment, or the setup
    elif isinstance(record, AgentSpec) and parameters and parameters[0].kind is not parameters[0].KEYWORD_ONLY:
        facts["argument"] = f"{_option(parameters.pop(0))}, as in {record.name}:…"
    facts["options"] = [_option(parameter) for parameter in parameters]
    facts["documentation"] = own_documentation(maker)
    return {**facts, **_describe_tools(record)} if isinstance(record, ToolSpec) else facts


def _describe_tools(record: ToolSpec) -> dict[str, Any]:
    """Describe a tool's status on this machine, and its instructions for an agent."""
    from gem_core.cli.diagnosis import status_of
    from gem_core.tools.selection import tools_by_name

    status, problem = status_of(record)
    tools: list[Any] = []
    try:
        tools = list(tools_by_name([record.name]).values())
    except GemError as error:  # it may need options, a key or a server; describe the rest
        problem = str(error)
    schemas, instructions = [tool.schema() for tool in tools], [tool.instructions() for tool in tools]
    return {"schemas": schemas, "instructions": instructions, "status": status, "problem": problem}


def option_lines(maker: Callable[..., Any]) -> list[str]:
    """Return what a callable takes, as ``name: type = default``."""
    return [_option(parameter) for parameter in (signature_of(maker) or inspect.Signature()).parameters.values()]


def own_documentation(maker: Callable[..., Any]) -> str | None:
    """Return the docstring of a class or function without its markup; not that of a base class."""
    own = vars(maker).get("__doc__") if isinstance(maker, type) else getattr(maker, "__doc__", None)
    return _ROLE.sub(r"\1", inspect.cleandoc(own)).replace("::\n", ":\n") if isinstance(own, str) else None


def _option(parameter: inspect.Parameter) -> str:
    written = parameter.annotation
    # Postponed annotations are strings, which inspect would quote.
    return str(parameter).replace(f": {written!r}", f": {written}", 1) if isinstance(written, str) else str(parameter)
