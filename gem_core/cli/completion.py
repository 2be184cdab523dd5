"""Types of parameters that a shell completes, with scripts for bash and fish that handle colons and commas."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import click
from click.shell_completion import BashComplete, CompletionItem, FishComplete, add_completion_class

from gem_core.errors import GemError
from gem_core.registry.lookup import registry
from gem_core.registry.specs import AgentSpec, NamedSpec, ToolSpec, VectorBackendSpec, WrapperSpec

if TYPE_CHECKING:
    # Here, as click before 8.5 has no generic CompletionItem.
    Items = list[CompletionItem[str]]
    Offer = Callable[[click.Context, str], Iterable[tuple[str, str]]]


class Words(click.types.StringParamType):
    """A parameter that is a word, completed from what is registered.

    Args:
        offer: Returns the words that fit what was typed, each with its summary.
        files: Whether the word may be a file or folder: one is completed if nothing else fits.
    """

    def __init__(self, offer: Offer, *, files: bool = False) -> None:
        self._offer, self._files = offer, files

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
        """Return the words; errors and warnings are left to the command itself."""
        if self._files and (incomplete.startswith((".", "~")) or os.sep in incomplete):
            return [CompletionItem(incomplete, type="file")]
        logger = logging.getLogger("gem_core")
        was, logger.disabled = logger.disabled, True
        try:
            items = [CompletionItem(word, help=summary or None) for word, summary in self._offer(ctx, incomplete)]
        except GemError:
            return []
        finally:
            logger.disabled = was
        return items or ([CompletionItem(incomplete, type="file")] if self._files and ":" not in incomplete else [])


def _names(*kinds: type[NamedSpec]) -> Offer:
    """Return what offers the names of records of some kinds, after the last comma of a list."""

    def offer(ctx: click.Context, incomplete: str) -> Iterable[tuple[str, str]]:
        before, comma, begun = incomplete.rpartition(",")
        records = sorted((record.name, record.summary) for kind in kinds for record in registry().specs(kind))
        return [(f"{before}{comma}{name}", summary) for name, summary in records if name.startswith(begun)]

    return offer


def env_ids(ctx: click.Context, incomplete: str) -> list[tuple[str, str]]:
    """Return the ids that begin with a text."""
    return [(record.id, record.summary) for record in registry().envs() if record.id.startswith(incomplete)]


def _agents(ctx: click.Context, incomplete: str) -> list[tuple[str, str]]:
    """Return agents, also behind the equals sign of a seat."""
    seat, equals, begun = incomplete.rpartition("=")
    return [(f"{seat}{equals}{name}", summary) for name, summary in _names(AgentSpec)(ctx, begun)]


def _ids_and_names(ctx: click.Context, incomplete: str) -> Iterable[tuple[str, str]]:
    """Return ids and, after a first letter, tools, wrappers, agents and backends."""
    named = _names(ToolSpec, WrapperSpec, AgentSpec, VectorBackendSpec)
    return [*env_ids(ctx, incomplete), *(named(ctx, incomplete) if incomplete else ())]


def _plugins(ctx: click.Context, incomplete: str) -> Iterable[tuple[str, str]]:
    return [(plugin.name, str(plugin)) for plugin in registry().plugins() if plugin.name.startswith(incomplete)]


ENVS = Words(env_ids, files=True)
ENVS_AND_NAMES = Words(_ids_and_names, files=True)
AGENTS = Words(_agents)
TOOLS = Words(_names(ToolSpec))
WRAPPERS = Words(_names(WrapperSpec, ToolSpec))
BACKENDS = Words(_names(VectorBackendSpec))
PLUGINS = Words(_plugins)


class ColonBash(BashComplete):
    """Completion for bash, which would take the colon of an id for the end of a word."""

    source_template = "COMP_WORDBREAKS=${COMP_WORDBREAKS//:}\n" + BashComplete.source_template


class CommaFish(FishComplete):
    """Completion for fish where words have commas, as lists of wrappers do: click's script would cut them there."""

    source_template = FishComplete.source_template.replace('string split ","', 'string split --max 1 ","')


for shell in (ColonBash, CommaFish):
    add_completion_class(shell)
