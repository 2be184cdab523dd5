"""``gem list``: the environments that can be made."""

from __future__ import annotations

import json
import re

import click

from gem_core.cli import tool_info
from gem_core.cli.completion import complete_env_ids
from gem_core.cli.layout import cut_at_word, output_width
from gem_core.cli.tool_info import KINDS
from gem_core.errors import UnknownEnvError
from gem_core.registry.lookup import registry
from gem_core.registry.plugins import Plugin, Record
from gem_core.registry.specs import EnvSpec
from gem_core.suggestions import did_you_mean


@click.command(
    "list",
    epilog="""\b
Examples:
  gem list
  gem list game
  gem list '*-easy'
  gem list tools                      likewise wrappers, agents, backends
  gem list --json | python -m json.tool
""",
)
@click.argument("pattern", required=False, shell_complete=complete_env_ids)
@click.option("--json", "as_json", is_flag=True, help="Write one JSON list, with all that is known of each.")
def command(pattern: str | None, as_json: bool) -> None:
    """List the environments that can be made.

    PATTERN is a namespace, a part of an id, or a glob in quotes; or one of tools, wrappers, agents and backends; or the
    name of a plugin, for all that it offers.
    """
    if pattern in KINDS and not any(record.namespace == pattern for record in registry().envs()):
        _print_named(pattern, as_json)
        return
    if pattern is not None and (offered := _offered_by(pattern)):
        _print_offered(offered, as_json)
        return
    records = matching(pattern)
    if as_json:
        click.echo(json.dumps([described(record) for record in records], indent=1))
    elif not records:
        click.echo("No environments are installed. Try 'pip install gem-games'.")
        others = _usable([plugin for plugin in registry().plugins() if not plugin.is_core])
        if others:
            _print_offered(others, as_json)
    else:
        _print_columns(records)


def matching(pattern: str | None) -> list[EnvSpec]:
    """Return the environments that a pattern means; all without one.

    Raises:
        UnknownEnvError: There is none; the message names the nearest.
    """
    records = registry().envs(pattern)
    if pattern is not None and not records:
        names = [record.id for record in registry().envs()]
        namespaces = sorted({record.namespace for record in registry().envs()})
        literal = re.sub(r"[*?\[\]]", "", pattern)
        raise UnknownEnvError(
            f"no environment matches {pattern!r}.{did_you_mean(literal, [*namespaces, *names])} "
            f"Namespaces: {', '.join(namespaces) or 'none'}. Run 'gem list'"
        )
    return records


def described(record: EnvSpec) -> dict[str, object]:
    """Return what is known of an environment without importing it."""
    provider = registry().provider(record.id)
    return {
        "id": record.id,
        "summary": record.summary,
        "kwargs": {key: value if _is_plain(value) else repr(value) for key, value in record.kwargs.items()},
        "max_turns": record.turn_limit,
        "tags": list(record.tags),
        "requires": list(record.requires),
        "deterministic": record.deterministic,
        "entry_point": record.entry_point if isinstance(record.entry_point, str) else repr(record.entry_point),
        "distribution": None if provider is None else provider.distribution,
    }


def _print_named(kind: str, as_json: bool) -> None:
    named = registry().named(KINDS[kind])
    if as_json:
        click.echo(json.dumps([tool_info.described(record) for record in named], indent=1))
    elif not named:
        click.echo(f"No {kind} are installed." + (" Try 'pip install gem-tools'." if kind == "tools" else ""))
    else:
        _print_rows([(record.name, record.summary) for record in named])


def _offered_by(name: str) -> list[Record]:
    """Return what the plugins of a name offer, where that is no namespace; nothing where there is no such plugin."""
    if any(record.namespace == name.removesuffix(":") for record in registry().envs()):
        return []
    plugins = [plugin for plugin in registry().plugins() if name in (plugin.name, plugin.distribution)]
    return _usable(plugins)


def _usable(plugins: list[Plugin]) -> list[Record]:
    """Return what some plugins offer, without the ids and names that are contested, or the core's."""
    found = registry()
    return [
        record
        for plugin in plugins
        for record in plugin.records
        if record in (found.envs() if isinstance(record, EnvSpec) else found.named(type(record)))
    ]


def _print_offered(records: list[Record], as_json: bool) -> None:
    if as_json:
        click.echo(
            json.dumps(
                [described(each) if isinstance(each, EnvSpec) else tool_info.described(each) for each in records],
                indent=1,
            )
        )
        return
    _print_rows(
        [(each.id if isinstance(each, EnvSpec) else f"{each.kind} {each.name}", each.summary) for each in records]
    )


def _print_columns(records: list[EnvSpec]) -> None:
    needs = [f" [needs {', '.join(record.requires)}]" if record.requires else "" for record in records]
    _print_rows([(record.id, f"{record.summary}{need}") for record, need in zip(records, needs, strict=True)])


def _print_rows(rows: list[tuple[str, str]]) -> None:
    # Plain lines, made without rich: importing it would take longer than all the rest.
    width = output_width()
    first = max(len(name) for name, _ in rows)
    for name, text in rows:
        rest = text if width is None else cut_at_word(text, max(width - first - 2, 0))
        click.echo(f"{click.style(name.ljust(first) if text else name, fg='cyan')}  {rest}".rstrip())


def _is_plain(value: object) -> bool:
    return value is None or isinstance(value, bool | int | float | str)
