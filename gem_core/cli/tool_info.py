"""What ``gem info`` and ``gem list`` say of tools and other things that have a short name."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable
from typing import Any

import click

from gem_core.arguments import signature_of
from gem_core.cli.layout import output_width
from gem_core.errors import GemError
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.specs import AgentSpec, NamedSpec, ToolSpec, VectorBackendSpec, WrapperSpec

KINDS: dict[str, type[NamedSpec]] = {
    "tools": ToolSpec,
    "wrappers": WrapperSpec,
    "agents": AgentSpec,
    "backends": VectorBackendSpec,
}
"""Words for ``gem list`` that are no pattern of ids."""


def find_named(name: str) -> list[NamedSpec]:
    """Return the tools, wrappers, agents and backends of a name; ``agent:ARGUMENT`` is the agent."""
    head, colon, _ = name.partition(":")
    kinds = [AgentSpec] if colon else list(KINDS.values())
    if colon and any(record.namespace == head for record in registry().envs()):
        return []
    return [record for kind in kinds for record in registry().named(kind) if record.name == head]


def described(record: NamedSpec) -> dict[str, Any]:
    """Return what is known of a record without importing what it points to."""
    provider = next((plugin for plugin in registry().plugins() if record in plugin.records), None)
    return {
        "kind": record.kind,
        "name": record.name,
        "summary": record.summary,
        "entry_point": record.entry_point if isinstance(record.entry_point, str) else repr(record.entry_point),
        "distribution": None if provider is None else provider.distribution,
    }


def all_about(record: NamedSpec) -> dict[str, Any]:
    """Return what is known of a record, with the options of what it points to, as plain JSON."""
    facts = described(record)
    maker = load_entry_point(record.entry_point, f"{record.kind} {record.name!r}")
    parameters = list((signature_of(maker) or inspect.Signature()).parameters.values())
    if isinstance(record, WrapperSpec | VectorBackendSpec):
        parameters = parameters[1:]  # the environment, or the setup
    elif isinstance(record, AgentSpec) and parameters and parameters[0].kind is not parameters[0].KEYWORD_ONLY:
        facts["argument"] = f"{_option(parameters.pop(0))}, as in {record.name}:…"
    facts["options"] = [_option(parameter) for parameter in parameters]
    facts["documentation"] = own_documentation(maker)
    if isinstance(record, ToolSpec):
        from gem_core.cli.diagnosis import status_of
        from gem_core.tools.selection import tools_by_name

        status, broken = status_of(record)
        facts |= {"schemas": [], "instructions": [], "status": status, "problem": broken}
        try:
            tools = tools_by_name([record.name]).values()
        except GemError as error:  # it may need options, a key or a server; all else can be told without
            facts["problem"] = str(error)
        else:
            facts |= {
                "schemas": [tool.schema() for tool in tools],
                "instructions": [tool.instructions() for tool in tools],
            }
    return facts


def print_named(facts: dict[str, Any]) -> None:
    """Describe a tool, wrapper, agent or backend: its options, and what an agent is told of a tool."""
    click.echo(click.style(facts["name"], bold=True) + (f" · {facts['summary']}" if facts["summary"] else ""))
    print_field("kind", facts["kind"])
    print_field("argument", facts.get("argument"))
    print_field("options", facts["options"] or "none")
    print_field("offered by", facts["distribution"] or "this program")
    print_field("entry point", facts["entry_point"])
    if facts.get("status"):
        from gem_core.cli.diagnosis import status_line

        print_field("here", status_line(facts["status"]))
    print_field("missing", facts.get("problem"))
    if facts["documentation"]:
        click.echo(f"\n{facts['documentation']}")
    if facts.get("instructions"):
        click.echo(click.style("\nWhat an agent is told, without options:", bold=True))
        for line in facts["instructions"]:
            click.echo(line)


def print_field(label: str, value: str | list[str] | None) -> None:
    """Show a fact behind its label, a list with a line for each; nothing where there is none."""
    lines = [value] if isinstance(value, str) else value or []
    width = output_width()
    if width is not None:
        lines = [piece for line in lines for piece in textwrap.wrap(line, max(width - 16, 20), break_long_words=False)]
    for number, line in enumerate(lines):
        head = f"{label}:" if number == 0 else ""
        click.echo(f"  {head:<14}{line}")


def option_lines(maker: Callable[..., Any]) -> list[str]:
    """Return what a callable takes, as ``name: type = default``."""
    return [_option(parameter) for parameter in (signature_of(maker) or inspect.Signature()).parameters.values()]


def own_documentation(maker: Callable[..., Any]) -> str | None:
    """Return the docstring of a class or function; not that of a base class, which is about something else."""
    own = vars(maker).get("__doc__") if isinstance(maker, type) else getattr(maker, "__doc__", None)
    return inspect.cleandoc(own) if isinstance(own, str) else None


def _option(parameter: inspect.Parameter) -> str:
    annotation = parameter.annotation
    # As it was written: a module with postponed annotations has them as text, which str() would quote.
    written = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    typed = "" if annotation is parameter.empty else f": {written}"
    stars = "*" * (parameter.kind is parameter.VAR_POSITIONAL) + "**" * (parameter.kind is parameter.VAR_KEYWORD)
    equals = " = " if typed else "="
    default = "" if parameter.default is parameter.empty else f"{equals}{parameter.default!r}"
    return f"{stars}{parameter.name}{typed}{default}"
