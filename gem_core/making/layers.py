"""Resolve the wrappers and tools of an environment, given by name, entry point or object, with their options."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeGuard, cast

from gem_core.arguments import check_arguments, parse_choice
from gem_core.errors import ArgumentError
from gem_core.registry.choices import parsed_choices
from gem_core.registry.entry_points import load_entry_point
from gem_core.registry.lookup import registry
from gem_core.registry.specs import EntryPoint, ToolSpec

if TYPE_CHECKING:
    from gem_core.tools.tool import Tool

Target: TypeAlias = "str | Tool | Callable[..., Any]"
"""A name, an entry point, a tool, or a callable that takes an environment; a class of tools is called without one."""

WrapperChoice: TypeAlias = "Target | tuple[Target, Mapping[str, Any]]"
"""A target, or a name or callable with its options."""

Stack: TypeAlias = "str | Sequence[WrapperChoice]"
"""Innermost first: ``"python,concat:max_turns=4"`` or ``["python", ("concat", {"max_turns": 4})]``."""

Wrappers: TypeAlias = "Stack | Mapping[str, Stack]"
"""One stack; or, if several agents act, a stack for each of some seats: ``{"white": "python,concat"}``."""

_TOOLS = "tools"
"""Name of the wrapper that gives tools to a task."""


class Layer(NamedTuple):
    """One wrapper that is to be put around an environment.

    Args:
        owner: What errors call it, as ``"wrapper 'concat'"``.
        entry_point: What is called with the environment and the options.
        options: Keyword arguments.
        name: Its registered name; None for what was given by entry point or as an object.
    """

    owner: str
    entry_point: EntryPoint
    options: dict[str, Any]
    name: str | None = None


def layers_of(wrappers: Stack) -> list[Layer]:
    """Return the layers that are asked for, innermost first; all tools share one, in the place of the first.

    So a call counts once, wherever its tool was named.
    """
    layers: list[Layer] = []
    gathered: dict[str, Any] | None = None
    for target, options in choices(wrappers):
        tools = _as_tools(target, options)
        if tools is None:
            layers.append(_layer(target, options))
            continue
        if gathered is None:
            gathered = {"tools": []}
            layers.append(_layer(_TOOLS, gathered))
        gathered["tools"] += tools.pop("tools")
        for name, value in tools.items():
            if gathered.setdefault(name, value) != value:
                raise ArgumentError(f"the tools are given {name} twice, as {gathered[name]!r} and as {value!r}")
    if gathered is not None and not gathered["tools"]:
        raise ArgumentError("options for tools are given, and no tool; name some, as in 'python,tools'")
    return layers


def check_options(wrappers: Wrappers) -> None:
    """Raise an error for an unknown wrapper, tool or option, before anything is made."""
    for target, options in _all_choices(wrappers):
        record = registry().wrapper(target) if is_name(target) else None
        if record is not None and options and target != _TOOLS:
            owner = f"{record.kind} {record.name!r}"
            args = () if isinstance(record, ToolSpec) else (None,)  # a wrapper takes the environment
            check_arguments(load_entry_point(record.entry_point, owner), args, options, owner)


def wrapper_targets(wrappers: Wrappers) -> list[Target]:
    """Return the name or object of each wrapper and tool that is asked for, those among the options of tools too."""
    targets: list[Target] = []
    for target, options in _all_choices(wrappers):
        targets.append(target)
        if target == _TOOLS:
            targets += [each[0] if isinstance(each, Sequence) and not isinstance(each, str) else each
                        for each in _named_tools(options)]  # fmt: skip
    return targets


def _all_choices(wrappers: Wrappers) -> list[tuple[Target, dict[str, Any]]]:
    if isinstance(wrappers, Mapping):
        return [choice for stack in wrappers.values() for choice in choices(stack)]
    return choices(wrappers)


def choices(wrappers: Stack) -> list[tuple[Target, dict[str, Any]]]:
    """Return each wrapper or tool that is asked for, with its options, innermost first.

    Raises:
        ArgumentError: Something is no wrapper.
    """
    if isinstance(wrappers, str):
        return [*parsed_choices(wrappers, "wrappers")]
    if not isinstance(wrappers, Iterable):
        raise ArgumentError(f"wrappers must be names joined by commas or a list, not {wrappers!r}")
    found: list[tuple[Target, dict[str, Any]]] = []
    for choice in wrappers:
        found += choices(choice) if isinstance(choice, str) else [_choice(choice)]
    return found


def is_name(target: object) -> TypeGuard[str]:
    """Tell whether a target is the name of a record."""
    return isinstance(target, str) and ":" not in target


def _choice(choice: WrapperChoice) -> tuple[Target, dict[str, Any]]:
    rule = "a wrapper is a name, a tool, a callable, or (name, {options})"
    return parse_choice(choice, rule, lambda one: isinstance(one, str) or callable(one) or _is_tool(one))


def _layer(target: Target, options: dict[str, Any]) -> Layer:
    if is_name(target):
        record = registry().wrapper(target)
        return Layer(f"{record.kind} {record.name!r}", record.entry_point, options, record.name)
    entry_point = cast("EntryPoint", target)
    shown = entry_point if isinstance(entry_point, str) else getattr(entry_point, "__qualname__", repr(entry_point))
    return Layer(f"wrapper {shown!r}", entry_point, options)


def _as_tools(target: Target, options: dict[str, Any]) -> dict[str, Any] | None:
    """Return a choice as options of ``ToolEnv``; None for any other wrapper."""
    if _is_tool(target):
        return {"tools": [(target, options) if isinstance(target, type) else target]}
    if target in (_TOOLS, "gem_core.tools.env:ToolEnv") or _is_tool_env(target):
        return {**options, "tools": _named_tools(options)}
    if is_name(target) and isinstance(registry().wrapper(target), ToolSpec):
        return {"tools": [(target, options)]}
    return None


# The modules of tools import pydantic, which takes longer than all the rest of `make`: what is given as a string, or
# not at all, loads none of them.


def _named_tools(options: Mapping[str, Any]) -> list[Any]:
    from gem_core.tools.selection import tool_choices

    return tool_choices(options.get("tools", []))


def _is_tool(target: object) -> bool:
    if isinstance(target, str | tuple | list):
        return False
    from gem_core.tools.tool import Tool

    return isinstance(target, Tool) or (isinstance(target, type) and issubclass(target, Tool))


def _is_tool_env(target: object) -> bool:
    if not isinstance(target, type):
        return False
    from gem_core.tools.env import ToolEnv

    return target is ToolEnv
