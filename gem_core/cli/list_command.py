"""``gem list``: the environments that can be made."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from operator import itemgetter

import click

from gem_core.cli.completion import ENVS
from gem_core.cli.descriptions import KINDS, describe_record
from gem_core.cli.documented import Documented
from gem_core.cli.layout import Column, output_width, print_table
from gem_core.docs import page_url
from gem_core.errors import UnknownEnvError
from gem_core.registry.lookup import registry
from gem_core.registry.plugins import Plugin, Record
from gem_core.registry.requirements import unmet
from gem_core.registry.specs import CommandSpec, EnvSpec
from gem_core.suggestions import did_you_mean


@click.command("list", cls=Documented)
@click.argument("pattern", required=False, type=ENVS)
@click.option("--all", "show_all", is_flag=True, help="Show every id, as in a pipe.")
@click.option("--json", "as_json", is_flag=True, help="Write one JSON list, with all fields.")
def command(pattern: str | None, show_all: bool, as_json: bool) -> None:
    """List the environments that can be made; in a terminal, a line for each namespace.

    PATTERN is a namespace, a part of an id, or a glob in quotes. The words tools, wrappers, agents and backends list
    these; the name of a plugin lists all that it offers.

    Examples:
      gem list
      gem list game
      gem list '*-easy'
      gem list tools                      likewise wrappers, agents, backends
      gem list | grep Sudoku              in a pipe: every id, one a line
      gem list --json | python -m json.tool
    """
    kind = None if pattern in {record.namespace for record in registry().envs()} else KINDS.get(pattern or "")
    records: Sequence[Record]
    records = registry().named(kind) if kind is not None else _offered_by(pattern) or matching(pattern)
    if as_json:
        click.echo(json.dumps([describe_record(record) for record in records], indent=1))
    elif not records:
        distribution = {None: "gem-games", "tools": "gem-tools"}.get(pattern)
        advice = f" Try 'pip install {distribution}'." if distribution else ""
        click.echo(f"No {pattern or 'environments'} are installed.{advice}")
        if pattern is None:
            _print_rows(map(_row, _usable(plugin for plugin in registry().plugins() if not plugin.is_core)))
    elif kind is not None:
        _print_rows((record.name, record.summary) for record in registry().named(kind))
    elif pattern is None and not show_all and output_width() is not None:
        _print_overview(registry().envs())
    else:
        _print_rows(map(_row, records))
        if output_width() is not None and any(isinstance(record, EnvSpec) for record in records):
            click.echo(click.style(f"\n{_gallery_line()}", dim=True))


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


def _offered_by(name: str | None) -> list[Record]:
    """Return the records of the plugins of a name; none if the name is a namespace, or of no plugin."""
    if name is None or any(record.namespace == name.removesuffix(":") for record in registry().envs()):
        return []
    return _usable(plugin for plugin in registry().plugins() if name in (plugin.name, plugin.distribution))


def _usable(plugins: Iterable[Plugin]) -> list[Record]:
    """Return the records of some plugins that can be used: ids and names that no other plugin claims."""
    found = registry()
    return [
        record
        for plugin in plugins
        for record in plugin.records
        if record in (found.envs() if isinstance(record, EnvSpec) else found.named(type(record)))
    ]


def _row(record: Record) -> tuple[str, str]:
    if not isinstance(record, EnvSpec):
        return f"{record.kind} {record.name}", record.summary
    needs = f" [needs {', '.join(record.requires)}]" if record.requires else ""
    return record.id, f"{record.summary}{needs}"


def _print_overview(envs: list[EnvSpec]) -> None:
    """Print a line for each namespace, with what all of it lacks here, then the names of all other things."""
    members: dict[str, list[EnvSpec]] = {}
    for record in envs:
        members.setdefault(record.namespace, []).append(record)
    width = max(map(len, members)) + 1
    rows = []
    for namespace, records in members.items():
        shared = [word for word in records[0].requires if all(word in record.requires for record in records)]
        missing = "; ".join(unmet(shared).values()) or f"needs {', '.join(shared)}"
        needs = f"[{missing}] " if shared else ""
        names = dict.fromkeys(re.split(r"-v\d", record.name)[0] for record in records)
        rows.append((f"{namespace + ':':<{width}} {len(records):>4}", needs + ", ".join(names)))
    _print_rows(rows)
    click.echo()
    others = {word: [record.name for record in registry().named(kind)] for word, kind in KINDS.items()}
    offered = _usable(plugin for plugin in registry().plugins() if not plugin.is_core)
    others["commands"] = [record.name for record in offered if isinstance(record, CommandSpec)]
    _print_rows((word, ", ".join(names)) for word, names in others.items() if names)
    click.echo(
        click.style(
            f"\n'gem list {next(iter(members))}' shows a namespace, 'gem list --all' every id.\n{_gallery_line()}",
            dim=True,
        )
    )


def _gallery_line() -> str:
    return f"Each family, with episodes to look at: {page_url('gallery/')}"


def _print_rows(pairs: Iterable[tuple[str, str]]) -> None:
    print_table([Column("", itemgetter(0), name=True), Column("", itemgetter(1), text=True)], pairs)
