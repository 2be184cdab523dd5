"""Options of ``gem run`` and ``gem play`` for arguments, tools and wrappers, and the command line to repeat a call."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from gem_core.cli.completion import TOOLS, WRAPPERS
from gem_core.errors import ArgumentError
from gem_core.registry.choices import OPTION, option_value
from gem_core.registry.choices import parsed_choices as parsed_choices
from gem_core.registry.lookup import registry
from gem_core.registry.specs import ToolSpec

if TYPE_CHECKING:
    from gem_core.making.layers import WrapperChoice

Command = TypeVar("Command", bound=Callable[..., Any])

NO_LIMIT = "none"


class AtLeast(click.IntRange):
    """A whole number from ``min`` up; click would call it an integer range."""

    name = "integer"


class _Limit(AtLeast):
    """A whole number, or the word for none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if value == NO_LIMIT else super().convert(value, param, ctx)


def stack_options(view: str) -> Callable[[Command], Command]:
    """Return what adds the options of ``wrapper_stack`` to a command.

    Args:
        view: What a view among the wrappers means to the command, for its help.
    """
    wrappers_help = (
        "Wrappers and tools, innermost first, with options after a colon: 'concat:max_turns=2,episode_stats'. "
        f"Can be repeated; 'gem info NAME' shows the options. {view}"
    )
    tools_help = "Tools that the agent may call, with options after a colon: 'python,search:top_k=2'. Can be repeated."
    uses_help = f"Most tool calls of an episode, or '{NO_LIMIT}' for no limit.  [default: 5]"
    options = [
        click.option("-t", "--max-turns", type=AtLeast(min=1), help="Cut off an episode after this many turns."),
        click.option("-w", "--wrappers", multiple=True, metavar="NAMES", type=WRAPPERS, help=wrappers_help),
        click.option("--tools", multiple=True, metavar="NAMES", type=TOOLS, help=tools_help),
        click.option("--max-tool-uses", type=_Limit(min=0), help=uses_help),
    ]

    def add(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def wrapper_stack(
    wrappers: tuple[str, ...], tools: tuple[str, ...], max_tool_uses: int | str | None, max_turns: int | None
) -> list[WrapperChoice]:
    """Return the wrappers of an environment, innermost first.

    Raises:
        ArgumentError: Wrappers or tools cannot be read, or a limit is given for tools and there are none.
        UnknownWrapperError: No wrapper or tool of that name.
    """
    stack: list[Any] = [tool for text in tools for tool in parsed_choices(text, "--tools")]
    for name, _ in stack:
        registry().tool(name)
    stack += [wrapper for text in wrappers for wrapper in parsed_choices(text, "--wrappers")]
    place = next((number for number, (name, _) in enumerate(stack) if _is_tool(name)), None)
    if max_tool_uses is not None and place is None:
        raise ArgumentError("--max-tool-uses is a limit of tools, and there are none; name some by --tools")
    if max_tool_uses is not None and place is not None:
        stack.insert(place, ("tools", {"max_tool_uses": None if max_tool_uses == NO_LIMIT else max_tool_uses}))
    if max_turns is not None:
        # Outside the tools, which are gathered in the place of the first and whose calls are turns too, and inside the
        # views and statistics, which see the end.
        stack.insert(0 if place is None else place + 1, ("turn_limit", {"max_turns": max_turns}))
    return stack


def _import(ctx: click.Context, param: click.Parameter, value: tuple[str, ...]) -> None:
    if value and not ctx.resilient_parsing:
        from gem_core.cli.targets import import_envs
        from gem_core.rollouts.agent import current_folder_importable

        ctx.with_resource(current_folder_importable())
        for word in value:
            import_envs(word)


import_option = click.option(
    "--import",
    "imports",
    multiple=True,
    metavar="MODULE",
    is_eager=True,
    expose_value=False,
    callback=_import,
    help="Import a module that registers environments, or a class as in my_env.py:MyEnv. Can be repeated.",
)
"""Adds the option for environments that no plugin offers."""

_set_option = click.option(
    "--set",
    "arguments",
    multiple=True,
    metavar="NAME=VALUE",
    help="Keyword argument of every environment, as JSON or text: 'max_turns=9'. Can be repeated; 'gem info ID' lists "
    "them.",
)


def arguments_option(command: Command) -> Command:
    """Add ``--set`` and ``--import``; see ``env_arguments``."""
    return _set_option(import_option(command))


def env_arguments(given: tuple[str, ...]) -> dict[str, Any]:
    """Return the keyword arguments of environments that ``--set`` gives.

    Raises:
        ArgumentError: One has another form.
    """
    arguments = {}
    for each in given:
        setting = OPTION.fullmatch(each)
        if setting is None:
            raise ArgumentError(f"--set takes NAME=VALUE, not {each!r}")
        arguments[setting[1]] = option_value(setting[2])
    return arguments


def typed_command(ctx: click.Context) -> str:
    """Return the call of ``gem`` as it was typed, quoted for a shell."""
    return shlex.join(["gem", *(ctx.find_root().obj or ())])


def _is_tool(name: str) -> bool:
    return name == "tools" or (":" not in name and isinstance(registry().wrapper(name), ToolSpec))
