"""Options of ``gem run`` and ``gem play`` for arguments, tools and wrappers, and the command line to repeat a call."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from gem_core.cli.completion import TOOLS, WRAPPERS
from gem_core.cli.players import check_seats
from gem_core.errors import ArgumentError
from gem_core.registry.choices import OPTION, option_value
from gem_core.registry.choices import parsed_choices as parsed_choices
from gem_core.registry.lookup import registry
from gem_core.registry.specs import ToolSpec

if TYPE_CHECKING:
    from gem_core.making.layers import WrapperChoice, Wrappers
    from gem_core.registry.specs import EnvSpec

Command = TypeVar("Command", bound=Callable[..., Any])

NO_LIMIT = "none"

_AT_SEAT = re.compile(r"([^=:,\[{]*)=(.*)", re.DOTALL)


def _uses(ctx: click.Context, param: click.Parameter, value: str | None) -> int | str | None:
    """Return a limit as it was given: a whole number from 0 up, or the word for none."""
    if value is None or value == NO_LIMIT:
        return value
    if re.fullmatch(r"\d{1,9}", value, re.ASCII):
        return int(value)
    raise click.BadParameter(f"{value!r} is neither a whole number from 0 up nor {NO_LIMIT!r}", ctx, param)


class AtLeast(click.IntRange):
    """A whole number from ``min`` up; click would call it an integer range."""

    name = "integer"


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
        click.option("--max-tool-uses", callback=_uses, metavar="INTEGER", help=uses_help),
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
    stack, has_tools = _stack(wrappers, tools, max_tool_uses, max_turns)
    _check_limit(max_tool_uses, has_tools)
    return stack


def wrapper_stacks(
    wrappers: tuple[str, ...],
    tools: tuple[str, ...],
    uses: int | str | None,
    max_turns: int | None,
    env: EnvSpec,
) -> Wrappers:
    """Return the wrappers of an environment; if several agents act, by seat if some are given as ``SEAT=NAMES``.

    Those without a seat are for all. See ``wrapper_stack``.
    """
    seats = {text: _AT_SEAT.fullmatch(text) for text in (*wrappers, *tools)}
    if not env.seats or not any(seats.values()):
        return wrapper_stack(wrappers, tools, uses, max_turns)
    check_seats((match[1] for match in seats.values() if match), env)

    def names_of(texts: tuple[str, ...], seat: str) -> tuple[str, ...]:
        matches = [(text, seats[text]) for text in texts]
        return tuple(match[2] if match else text for text, match in matches if match is None or match[1] == seat)

    stacks = {seat: _stack(names_of(wrappers, seat), names_of(tools, seat), uses, max_turns) for seat in env.seats}
    _check_limit(uses, any(has_tools for _, has_tools in stacks.values()))
    return {seat: stack for seat, (stack, _) in stacks.items()}


def _check_limit(max_tool_uses: int | str | None, has_tools: bool) -> None:
    if max_tool_uses is not None and not has_tools:
        raise ArgumentError("--max-tool-uses is a limit of tools, and there are none; name some by --tools")


def _stack(
    wrappers: tuple[str, ...], tools: tuple[str, ...], max_tool_uses: int | str | None, max_turns: int | None
) -> tuple[list[WrapperChoice], bool]:
    """Return the wrappers, innermost first, and whether there are tools among them."""
    stack: list[Any] = [tool for text in tools for tool in parsed_choices(text, "--tools")]
    for name, _ in stack:
        registry().tool(name)
    stack += [wrapper for text in wrappers for wrapper in parsed_choices(text, "--wrappers")]
    place = next((number for number, (name, _) in enumerate(stack) if _is_tool(name)), None)
    if max_tool_uses is not None and place is not None:
        stack.insert(place, ("tools", {"max_tool_uses": None if max_tool_uses == NO_LIMIT else max_tool_uses}))
    if max_turns is not None:
        # Outside the tools, which are gathered in the place of the first and whose calls are turns too, and inside the
        # views and statistics, which see the end.
        stack.insert(0 if place is None else place + 1, ("turn_limit", {"max_turns": max_turns}))
    return stack, place is not None


def _import(ctx: click.Context, param: click.Parameter, value: tuple[str, ...]) -> None:
    if value and not ctx.resilient_parsing:
        from gem_core.cli.targets import import_envs
        from gem_core.rollouts.agent import current_folder_importable

        ctx.with_resource(current_folder_importable())
        ctx.meta["imports"] = value
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


def call_again(ctx: click.Context, without: Collection[str], *more: str) -> str:
    """Return what to type to call a command again with the options that it was given.

    Args:
        ctx: Of the call.
        without: Names of parameters that are left out.
        more: Words that follow the command's arguments.
    """
    arguments: list[str] = []
    options: list[str] = []
    for parameter in ctx.command.params:
        name = str(parameter.name)
        value: Any = ctx.params.get(name, ctx.meta.get(name))
        if name in without or ctx.get_parameter_source(name) != ParameterSource.COMMANDLINE:
            continue
        if isinstance(parameter, click.Argument):
            arguments += value if isinstance(value, tuple) else [value]
        elif getattr(parameter, "is_flag", False):
            options += parameter.opts[-1:]
        else:
            for each in value if parameter.multiple else [value]:
                options += [parameter.opts[-1], str(each)]
    return shlex.join([*ctx.command_path.split(), *arguments, *more, *options])


def _is_tool(name: str) -> bool:
    return name == "tools" or (":" not in name and isinstance(registry().wrapper(name), ToolSpec))
