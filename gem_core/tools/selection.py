"""Resolve tools that are given as objects, classes or names, each with its options."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gem_core.arguments import check_arguments, parse_choice
from gem_core.errors import ArgumentError
from gem_core.registry.choices import parsed_choices
from gem_core.registry.entry_points import construct
from gem_core.registry.lookup import registry
from gem_core.tools.tool import Tool

ToolChoice = Tool | type[Tool] | str | tuple[str | type[Tool], Mapping[str, Any]]
"""A tool, a class of tools, the name of a registered one, or a class or name with options."""

ToolChoices = Tool | str | Sequence[ToolChoice]
"""One tool, names joined by commas and with options, as in ``"python,search:top_k=2"``, or a list."""


def tool_choices(tools: ToolChoices) -> list[Any]:
    """Return tools that are asked for as a list."""
    if isinstance(tools, str):
        return [*parsed_choices(tools, "tools")]
    return [tools] if isinstance(tools, Tool | type) else list(tools)


def tools_by_name(choices: Iterable[ToolChoice]) -> dict[str, Tool]:
    """Return the tools that were chosen by their names, in order.

    Raises:
        UnknownToolError: No tool of that name is registered.
        ArgumentError: Two tools have one name, or something is no tool.
    """
    tools: dict[str, Tool] = {}
    for choice in choices:
        for tool in _made(choice):
            if tool.name in tools:
                raise ArgumentError(
                    f"two tools have one name, {tool.name!r}; calls could not be told apart, so leave one out, or give "
                    "it another name by its options"
                )
            tools[tool.name] = tool
    return tools


def _made(choice: ToolChoice) -> list[Tool]:
    if isinstance(choice, Tool):
        return [choice]
    maker, options = parse_choice(choice, "a tool is a Tool, a name, or (name, {options})", _is_maker)
    if isinstance(maker, type):
        check_arguments(maker, (), options, f"tool {maker.__name__!r}")
        return [maker(**options)]
    made = construct(registry().tool(maker), **options)
    found = list(made) if isinstance(made, Sequence) and not isinstance(made, str) else [made]
    for tool in found:
        if not isinstance(tool, Tool):
            raise ArgumentError(f"the entry point of tool {maker!r} returned {type(tool).__name__}, not a Tool")
    return found


def _is_maker(choice: object) -> bool:
    return isinstance(choice, str) or (isinstance(choice, type) and issubclass(choice, Tool))
