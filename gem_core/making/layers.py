"""Resolve the wrappers and tools of an environment, given by name, entry point or object, with their options."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

from gem_core.arguments import parse_choice
from gem_core.errors import ArgumentError
from gem_core.registry.choices import parsed_choices
from gem_core.registry.lookup import registry
from gem_core.registry.specs import EntryPoint, NamedSpec, ToolSpec

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
    """One wrapper or tool that is asked for.

    Args:
        target: What it was given by.
        options: Keyword arguments.
        record: Its record; None for what was given by entry point or as an object.
    """

    target: Target
    options: dict[str, Any]
    record: NamedSpec | None

    @property
    def owner(self) -> str:
        """What errors call it, as ``"wrapper 'concat'"``."""
        if self.record is not None:
            return f"{self.record.kind} {self.record.name!r}"
        shown = self.target if isinstance(self.target, str) else getattr(self.target, "__qualname__", repr(self.target))
        return f"wrapper {shown!r}"

    @property
    def entry_point(self) -> EntryPoint:
        """What is called with the environment and the options."""
        return cast("EntryPoint", self.target) if self.record is None else self.record.entry_point


def asked_for(wrappers: Wrappers) -> list[Layer]:
    """Return each wrapper and tool that is asked for, innermost first, of all seats.

    Raises:
        ArgumentError: Something is no wrapper.
        UnknownWrapperError: There is no wrapper or tool of a name.
    """
    if isinstance(wrappers, Mapping):
        return [layer for stack in wrappers.values() for layer in asked_for(stack)]
    if not isinstance(wrappers, Iterable):
        raise ArgumentError(f"wrappers must be names joined by commas or a list, not {wrappers!r}")
    rule = "a wrapper is a name, a tool, a callable, or (name, {options})"
    choices: list[tuple[Target, dict[str, Any]]] = []
    for given in [wrappers] if isinstance(wrappers, str) else wrappers:
        choices += parsed_choices(given, "wrappers") if isinstance(given, str) else [parse_choice(given, rule, _is_one)]
    return [Layer(target, options, _record_of(target)) for target, options in choices]


def layers_of(wrappers: Stack) -> list[Layer]:
    """Return the layers to put around an environment, innermost first; all tools share one, in the place of the first.

    So a call counts once, wherever its tool was named.
    """
    layers: list[Layer] = []
    gathered: dict[str, Any] | None = None
    for layer in asked_for(wrappers):
        target, options = layer.target, dict(layer.options)
        if isinstance(layer.record, ToolSpec) or _is_tool(target):
            tools = [(target, options) if isinstance(target, str | type) else target]
            options = {}
        elif target == _TOOLS:
            tools = _named_tools(options.pop("tools", []))
        else:
            layers.append(layer)
            continue
        if gathered is None:
            gathered = {"tools": []}
            layers.append(Layer(_TOOLS, gathered, registry().wrapper(_TOOLS)))
        gathered["tools"] += tools
        for name, value in options.items():
            if gathered.setdefault(name, value) != value:
                raise ArgumentError(f"the tools are given {name} twice, as {gathered[name]!r} and as {value!r}")
    if gathered is not None and not gathered["tools"]:
        raise ArgumentError("options for tools are given, and no tool; name some, as in 'python,tools'")
    return layers


def wrapper_targets(wrappers: Wrappers) -> list[Target]:
    """Return the name or object of each wrapper and tool that is asked for, those among the options of tools too."""
    targets: list[Target] = []
    for layer in asked_for(wrappers):
        targets.append(layer.target)
        if layer.target == _TOOLS:
            named = _named_tools(layer.options.get("tools", []))
            targets += [each[0] if isinstance(each, tuple | list) else each for each in named]
    return targets


def _is_one(target: object) -> bool:
    return isinstance(target, str) or callable(target) or _is_tool(target)


def _record_of(target: Target) -> NamedSpec | None:
    return registry().wrapper(target) if isinstance(target, str) and ":" not in target else None


# The modules of tools import pydantic, which takes longer than all the rest of `make`: what is given as a string, or
# not at all, loads none of them.


def _named_tools(tools: Any) -> list[Any]:
    from gem_core.tools.selection import tool_choices

    return tool_choices(tools)


def _is_tool(target: object) -> bool:
    if isinstance(target, str | tuple | list):
        return False
    from gem_core.tools.tool import Tool

    return isinstance(target, Tool) or (isinstance(target, type) and issubclass(target, Tool))
