"""What a shell completes, and scripts for bash and fish that can handle the colons and commas in it."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from click.shell_completion import (
    BashComplete,
    CompletionItem,
    FishComplete,
    add_completion_class,
    split_arg_string,
)

if TYPE_CHECKING:
    import click

    from gem_core.registry.lookup import Registry

SHELLS = ("bash", "zsh", "fish")


def complete_env_ids(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Return the ids that begin so; the namespaces first, where several are left."""
    with _quiet_registry() as found:
        records = [record for record in found.envs() if record.id.startswith(incomplete)]
        namespaces = list(dict.fromkeys(f"{record.namespace}:" for record in records))
        if len(namespaces) > 1:
            return [CompletionItem(namespace) for namespace in namespaces]
        return [CompletionItem(record.id, help=record.summary or None) for record in records]
    return []


def complete_agents(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Return the agents whose names begin so."""
    from gem_core.registry.specs import AgentSpec

    with _quiet_registry() as found:
        return _items(incomplete, ((record.name, record.summary) for record in found.named(AgentSpec)))
    return []


def complete_backends(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Return the backends of vector environments whose names begin so."""
    from gem_core.registry.specs import VectorBackendSpec

    with _quiet_registry() as found:
        return _items(incomplete, ((record.name, record.summary) for record in found.named(VectorBackendSpec)))
    return []


def complete_wrappers(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Return the wrappers and tools that fit behind the last comma."""
    from gem_core.registry.specs import ToolSpec, WrapperSpec

    before, comma, begun = incomplete.rpartition(",")
    with _quiet_registry() as found:
        records = [*found.named(WrapperSpec), *found.named(ToolSpec)]
        items = _items(begun, sorted((record.name, record.summary) for record in records))
        return [CompletionItem(f"{before}{comma}{item.value}", help=item.help) for item in items]
    return []


def complete_tools(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Return the tools that fit behind the last comma."""
    from gem_core.registry.specs import ToolSpec

    before, comma, begun = incomplete.rpartition(",")
    with _quiet_registry() as found:
        items = _items(begun, ((record.name, record.summary) for record in found.named(ToolSpec)))
        return [CompletionItem(f"{before}{comma}{item.value}", help=item.help) for item in items]
    return []


def complete_ids_and_names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Return the ids that begin so, and behind a first letter the tools, wrappers, agents and backends."""
    from gem_core.cli.descriptions import KINDS

    found = complete_env_ids(ctx, param, incomplete)
    if not incomplete:
        return found
    with _quiet_registry() as known:
        records = [record for kind in KINDS.values() for record in known.named(kind)]
        found += _items(incomplete, ((record.name, record.summary) for record in records))
    return found


def complete_plugins(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem[str]]:
    """Return the installed plugins whose names begin so."""
    with _quiet_registry() as found:
        return _items(incomplete, ((plugin.name, str(plugin)) for plugin in found.plugins()))
    return []


def _items(incomplete: str, named: Iterable[tuple[str, str]]) -> list[CompletionItem[str]]:
    return [CompletionItem(name, help=summary or None) for name, summary in named if name.startswith(incomplete)]


@contextmanager
def _quiet_registry() -> Iterator[Registry]:
    """Give the registry without a word on the terminal, where somebody is just typing."""
    from gem_core.errors import GemError
    from gem_core.registry.lookup import registry

    logger = logging.getLogger("gem_core")
    was = logger.disabled
    logger.disabled = True
    try:
        yield registry()
    except GemError:
        pass  # the command itself will say what is wrong
    finally:
        logger.disabled = was


class ColonBash(BashComplete):
    """Completion for bash where words have colons, as ids do.

    bash takes a colon for the end of a word, so that click's own script would see three words in ``game:Mast``. Here
    the line is read instead, and the part before the last colon is left out of what is given back.
    """

    source_template = """\
%(complete_func)s() {
    local line=${COMP_LINE:0:COMP_POINT} IFS=$'\\n' response word prefix="" type value
    word=${line##*[[:space:]]}
    if [[ $word == *:* && $COMP_WORDBREAKS == *:* ]]; then
        prefix=${word%%"${word##*:}"}
    fi
    response=$(env GEM_COMP_LINE="$line" %(complete_var)s=bash_complete "$1" 2>/dev/null)
    COMPREPLY=()
    while IFS=',' read -r type value; do
        case $type in
            dir) compopt -o dirnames ;;
            file) compopt -o default ;;
            plain)
                COMPREPLY+=("${value#"$prefix"}")
                [[ $value == *: ]] && compopt -o nospace ;;
        esac
    done <<< "$response"
    return 0
}
complete -o nosort -F %(complete_func)s %(prog_name)s
"""

    @staticmethod
    def _check_version() -> None:
        """Spare the call of bash by which click finds out its version: ``nosort`` needs 4.4, of 2016."""

    def get_completion_args(self) -> tuple[list[str], str]:
        """Return the whole words before the cursor, and the one that is begun."""
        line = os.environ["GEM_COMP_LINE"]
        words = split_arg_string(line)[1:]
        return (words, "") if not words or line[-1:].isspace() else (words[:-1], words[-1])


class CommaFish(FishComplete):
    """Completion for fish where words have commas, as lists of wrappers do: click's script would cut them there."""

    source_template = FishComplete.source_template.replace('string split ","', 'string split --max 1 ","')


add_completion_class(ColonBash)
add_completion_class(CommaFish)
