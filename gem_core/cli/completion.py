"""Shell completion of ids and names, with scripts for bash and fish that handle colons and commas."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING

from click.shell_completion import (
    BashComplete,
    CompletionItem,
    FishComplete,
    ShellComplete,
    ZshComplete,
    add_completion_class,
    split_arg_string,
)

from gem_core.errors import GemError
from gem_core.registry.lookup import registry
from gem_core.registry.specs import AgentSpec, NamedSpec, ToolSpec, VectorBackendSpec, WrapperSpec

if TYPE_CHECKING:
    import click

    # Here, as click before 8.5 has no generic CompletionItem.
    Items = list[CompletionItem[str]]
    Completer = Callable[[click.Context, click.Parameter, str], Items]


def _quiet(complete: Completer) -> Completer:
    """Return a completer without errors and warnings while the user is typing; the command itself will report them."""

    @wraps(complete)
    def quiet(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
        logger = logging.getLogger("gem_core")
        was, logger.disabled = logger.disabled, True
        try:
            return complete(ctx, param, incomplete)
        except GemError:
            return []
        finally:
            logger.disabled = was

    return quiet


def _names(*kinds: type[NamedSpec]) -> Completer:
    """Return a completer for the names of records of some kinds, after the last comma of a list."""

    def complete(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
        before, comma, begun = incomplete.rpartition(",")
        records = [record for kind in kinds for record in registry().named(kind) if record.name.startswith(begun)]
        return [
            CompletionItem(f"{before}{comma}{record.name}", help=record.summary or None)
            for record in sorted(records, key=lambda record: record.name)
        ]

    return _quiet(complete)


_complete_agent_names = _names(AgentSpec)
complete_backends = _names(VectorBackendSpec)
complete_tools = _names(ToolSpec)
complete_wrappers = _names(WrapperSpec, ToolSpec)
_complete_names = _names(ToolSpec, WrapperSpec, AgentSpec, VectorBackendSpec)


@_quiet
def complete_env_ids(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """Return the ids that begin with the text, only namespaces while several of them match; folders behind a slash."""
    if incomplete.startswith(".") or "/" in incomplete:
        return [CompletionItem(incomplete, type="dir")]
    records = [record for record in registry().envs() if record.id.startswith(incomplete)]
    namespaces = list(dict.fromkeys(f"{record.namespace}:" for record in records))
    if len(namespaces) > 1:
        return [CompletionItem(namespace) for namespace in namespaces]
    return [CompletionItem(record.id, help=record.summary or None) for record in records]


@_quiet
def complete_seats(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """Return the seats of the environments that were named before."""
    # While an option still lacks its value, click leaves the other words where they are.
    ids = [*ctx.args, *(ctx.params.get("ids") or ()), ctx.params.get("env_id")]
    seats = dict.fromkeys(seat for record in registry().envs() if record.id in ids for seat in record.seats)
    return [CompletionItem(seat) for seat in seats if seat.startswith(incomplete)]


def complete_agents(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """Return the seats that begin with the text, as ``white=``, and the agents; behind an equals sign the agents."""
    seat, equals, begun = incomplete.rpartition("=")
    agents = _complete_agent_names(ctx, param, begun)
    if equals:
        return [CompletionItem(f"{seat}={agent.value}", help=agent.help) for agent in agents]
    return [CompletionItem(f"{seat.value}=") for seat in complete_seats(ctx, param, incomplete)] + agents


def complete_ids_and_names(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """Return the matching ids and, after a first letter, the tools, wrappers, agents and backends."""
    ids = complete_env_ids(ctx, param, incomplete)
    return ids + _complete_names(ctx, param, incomplete) if incomplete else ids


@_quiet
def complete_plugins(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """Return the installed plugins whose names begin with the text."""
    plugins = [plugin for plugin in registry().plugins() if plugin.name.startswith(incomplete)]
    return [CompletionItem(plugin.name, help=str(plugin)) for plugin in plugins]


class ColonBash(BashComplete):
    """Completion for bash where words have colons, as ids do, and equals signs, as agents at seats do.

    bash takes either for the end of a word, so that click's own script would see three words in ``game:Mast``. Here
    the line is read instead, and the part before the last of them is removed from the completions.
    """

    source_template = """\
%(complete_func)s() {
    local line=${COMP_LINE:0:COMP_POINT} IFS=$'\\n' response word prefix="" type value
    local breaks=${COMP_WORDBREAKS//[^:=]/}
    word=${line##*[[:space:]]}
    if [[ -n $breaks && $word == *[$breaks]* ]]; then
        prefix=${word%%"${word##*[$breaks]}"}
    fi
    response=$(env GEM_COMP_LINE="$line" %(complete_var)s=bash_complete "$1" 2>/dev/null)
    COMPREPLY=()
    while IFS=',' read -r type value; do
        case $type in
            dir) compopt -o dirnames ;;
            file) compopt -o default ;;
            plain)
                COMPREPLY+=("${value#"$prefix"}")
                [[ $value == *[:=] ]] && compopt -o nospace ;;
        esac
    done <<< "$response"
    return 0
}
complete -o nosort -F %(complete_func)s %(prog_name)s
"""

    def get_completion_args(self) -> tuple[list[str], str]:
        """Return the complete words before the cursor, and the incomplete one."""
        line = os.environ["GEM_COMP_LINE"]
        words = split_arg_string(line)[1:]
        return (words, "") if not words or line[-1:].isspace() else (words[:-1], words[-1])


class CommaFish(FishComplete):
    """Completion for fish where words have commas, as lists of wrappers do: click's script would cut them there."""

    source_template = FishComplete.source_template.replace('string split ","', 'string split --max 1 ","')


SHELLS: dict[str, type[ShellComplete]] = {"bash": ColonBash, "zsh": ZshComplete, "fish": CommaFish}

for shell in SHELLS.values():
    add_completion_class(shell)
