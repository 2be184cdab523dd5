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
from gem_core.registry.plugins import Record
from gem_core.registry.requirements import unmet
from gem_core.registry.specs import CommandSpec, EnvSpec, NamedSpec
from gem_core.suggestions import did_you_mean


@click.command("list", cls=Documented)
@click.argument("pattern", required=False, type=ENVS)
@click.option("--all", "show_all", is_flag=True, help="Show every id, as in a pipe.")
@click.option("--json", "as_json", is_flag=True, help="Write one JSON list, with all fields.")
def command(pattern: str | None, show_all: bool, as_json: bool) -> None:
    """List the environments that can be made; in a terminal, a line for each namespace.

    PATTERN is a namespace, a part of an id, or a glob in quotes. The words tools, wrappers, agents and backends list
    these.

    Examples:
      gem list
      gem list game
      gem list '*-easy'
      gem list tools                      likewise wrappers, agents, backends
      gem list | grep Sudoku              in a pipe: every id, one a line
      gem list --json | python -m json.tool
    """
    found = registry()
    kind = None if pattern in {record.namespace for record in found.envs()} else KINDS.get(pattern or "")
    records: Sequence[Record] = matching(pattern) if kind is None else found.specs(kind)
    in_terminal = output_width() is not None
    if as_json:
        click.echo(json.dumps([describe_record(record) for record in records], indent=1))
    elif not records:
        click.echo(f"No {pattern or 'environments'} are installed; 'pip install gem-games gem-tools' brings some.")
    elif pattern is None and not show_all and in_terminal:
        _print_overview(found.envs())
    else:
        _print_rows(map(_row, records))
        if kind is None and in_terminal:
            click.secho(f"\n{_gallery_line()}", dim=True)


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


def _row(record: Record) -> tuple[str, str]:
    if not isinstance(record, EnvSpec):
        return record.name, record.summary
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
    kinds: dict[str, type[NamedSpec]] = {**KINDS, "commands": CommandSpec}
    others = {word: ", ".join(record.name for record in registry().specs(kind)) for word, kind in kinds.items()}
    _print_rows((word, names) for word, names in others.items() if names)
    shown = f"'gem list {next(iter(members))}' shows a namespace, 'gem list --all' every id."
    click.secho(f"\n{shown}\n{_gallery_line()}", dim=True)


def _gallery_line() -> str:
    return f"Each family, with episodes to look at: {page_url('gallery/')}"


def _print_rows(pairs: Iterable[tuple[str, str]]) -> None:
    print_table([Column("", itemgetter(0), name=True), Column("", itemgetter(1), text=True)], pairs)
