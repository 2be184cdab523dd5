"""The options of ``gem run`` and ``gem play`` that put tools around an environment, and the stack that they make."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from gem_core.cli.completion import complete_tools
from gem_core.errors import ArgumentError
from gem_core.registry import registry
from gem_core.specs import ToolSpec

if TYPE_CHECKING:
    from gem_core.making import WrapperChoice

Command = TypeVar("Command", bound=Callable[..., Any])

NO_LIMIT = "none"

# Before the first colon of a tool there is no equals sign, so that what has one goes on with the tool before it.
_TOOL = re.compile(r"\s*([\w.-]+)\s*(?::(.*))?", re.ASCII | re.DOTALL)
_OPTION = re.compile(r"\s*(\w+)\s*=(.*)", re.ASCII | re.DOTALL)
_FORM = "'python,search:top_k=2' or JSON as in '[[\"search\", {\"top_k\": 2}]]'"


def _uses(ctx: click.Context, param: click.Parameter, value: str | None) -> int | str | None:
    """Return a limit as it was given: a whole number from 0 up, or the word for none."""
    if value is None or value == NO_LIMIT:
        return value
    if re.fullmatch(r"\d{1,9}", value, re.ASCII):
        return int(value)
    raise click.BadParameter(f"{value!r} is neither a whole number from 0 up nor {NO_LIMIT!r}", ctx, param)


_OPTIONS = [
    click.option(
        "--tools",
        multiple=True,
        metavar="NAMES",
        shell_complete=complete_tools,
        help="Tools that the agent may call, with options behind a colon: 'python,search:top_k=2'. Can be repeated.",
    ),
    click.option(
        "--max-tool-uses",
        callback=_uses,
        metavar="INTEGER",
        help=f"Tool calls in an episode, or '{NO_LIMIT}' for no limit.  [default: 5]",
    ),
]


def tool_options(command: Command) -> Command:
    """Add the options to a command, which gets them as ``tools`` and ``max_tool_uses``."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def wrapper_stack(
    wrappers: str, tools: tuple[str, ...], max_tool_uses: int | str | None, max_turns: int | None
) -> list[WrapperChoice]:
    """Return what is put around an environment, innermost first.

    Raises:
        ArgumentError: Tools cannot be read, or a limit is given for tools and there are none.
        UnknownWrapperError: No wrapper or tool of that name.
    """
    names = [name.strip() for name in wrappers.split(",") if name.strip()]
    chosen = [tool for text in tools for tool in parsed_tools(text)]
    stack: list[Any] = [*chosen, *names]
    place = next((number for number, name in enumerate(stack) if _is_tool(name)), None)
    if max_tool_uses is not None:
        if place is None:
            raise ArgumentError("--max-tool-uses is a limit of tools, and there are none; name some by --tools")
        limit = None if max_tool_uses == NO_LIMIT else max_tool_uses
        stack.insert(place, ("tools", {"max_tool_uses": limit}))
    if max_turns is not None:
        # Outside the tools, which are gathered in the place of the first and whose calls are turns too, and inside the
        # views and statistics, which see the end.
        stack.insert(0 if place is None else place + 1, ("turn_limit", {"max_turns": max_turns}))
    return stack


def options_again(tools: tuple[str, ...], max_tool_uses: int | str | None) -> list[str]:
    """Return the words to type for the same tools."""
    uses = [] if max_tool_uses is None else ["--max-tool-uses", str(max_tool_uses)]
    return [word for text in tools for word in ("--tools", text)] + uses


def parsed_tools(text: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the tools of one ``--tools``, each with its options.

    A value of an option is JSON where it can be read as such, and text otherwise.

    Raises:
        ArgumentError: It is neither a list of names nor JSON.
        UnknownToolError: No such tool.
    """
    tools = _from_json(text) if text.lstrip().startswith(("[", "{")) else _from_words(text)
    for name, _ in tools:
        registry().tool(name)
    return tools


def _from_words(text: str) -> list[tuple[str, dict[str, Any]]]:
    tools: list[tuple[str, dict[str, Any]]] = []
    for word in text.split(","):
        option = _OPTION.fullmatch(word)
        tool = _TOOL.fullmatch(word)
        if option and tools:
            tools[-1][1][option[1]] = _value(option[2])
        elif tool:
            tools.append((tool[1], {}))
            first = None if tool[2] is None else _OPTION.fullmatch(tool[2])
            if first:
                tools[-1][1][first[1]] = _value(first[2])
            elif tool[2] is not None:
                raise ArgumentError(f"--tools: {tool[2]!r} is no option of {tool[1]!r}; write {_FORM}")
        elif word.strip():
            raise ArgumentError(f"--tools: {word!r} is no name of a tool; write {_FORM}")
    return tools


def _from_json(text: str) -> list[tuple[str, dict[str, Any]]]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ArgumentError(f"--tools is no valid JSON: {error}; write {_FORM}") from None
    if isinstance(content, dict):  # {"search": {"top_k": 2}, "python": {}}
        content = list(content.items())
    tools = [
        (each, {}) if isinstance(each, str) else tuple(each) if isinstance(each, list | tuple) else ()
        for each in content
    ]
    for tool in tools:
        if len(tool) != 2 or not isinstance(tool[0], str) or not isinstance(tool[1], dict):
            raise ArgumentError(
                f"--tools must be a list of names, or of names with options, not {text:.200}; write {_FORM}"
            )
    return tools


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _is_tool(choice: object) -> bool:
    name = choice[0] if isinstance(choice, tuple) else choice
    return name == "tools" or isinstance(registry().wrapper(str(name)), ToolSpec)
