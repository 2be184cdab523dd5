"""What an argument of the command line means: an id, a glob, or a folder that belongs to an environment."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from gem_core.cli.list_command import matching
from gem_core.errors import UnknownEnvError
from gem_core.registry.lookup import registry
from gem_core.registry.requirements import unmet
from gem_core.registry.specs import EnvSpec


def find_env(id_or_folder: str) -> tuple[EnvSpec, dict[str, Any]]:
    """Return the record of an environment, and keyword arguments for it: the folder, where one was given.

    Raises:
        UnknownEnvError: There is no such id or folder, or the folder belongs to no environment.
    """
    folder = Path(id_or_folder)
    if ":" in id_or_folder or not (folder.is_dir() or os.sep in id_or_folder):
        return registry().env(id_or_folder), {}
    if not folder.is_dir():
        raise UnknownEnvError(f"there is no folder {id_or_folder!r}")
    record = registry().env_of_folder(folder)
    return record, {record.folder_keyword: id_or_folder}


def find_envs(given: tuple[str, ...], *, several: bool) -> list[tuple[EnvSpec, dict[str, Any]]]:
    """Return the environments that ids, globs and folders stand for, each with its keyword arguments, and each once.

    Args:
        given: What was typed.
        several: Whether a glob stands for environments of several agents, where it matches those of one as well.
    """
    expanded: list[tuple[EnvSpec, dict[str, Any]]] = []
    for each in given:
        if any(character in each for character in "*?["):
            expanded += [(record, {}) for record in _runnable(_of_one_kind(matching(each), several=several))]
        else:
            expanded.append(find_env(each))
    return [one for place, one in enumerate(expanded) if one not in expanded[:place]]


def _of_one_kind(records: Sequence[EnvSpec], *, several: bool) -> Sequence[EnvSpec]:
    """Return the records of environments of several agents, or else those of one; all if they are of one kind."""
    kept = [record for record in records if bool(record.seats) == several]
    left_out = [record.id for record in records if bool(record.seats) != several]
    if not kept or not left_out:
        return records
    kind = "one agent" if several else "several agents"
    click.echo(f"gem: left out {len(left_out)} of {len(records)} for {kind}: {', '.join(left_out)}", err=True)
    return kept


def _runnable(records: Sequence[EnvSpec]) -> Sequence[EnvSpec]:
    """Return the records that match a glob, without those that cannot run here; all if none can."""
    closed = {record.id for record in records if unmet(record.requires)}
    if not closed or len(closed) == len(records):
        return records
    click.echo(
        f"gem: left out {len(closed)} of {len(records)} that cannot run here ('gem info ID' says why): "
        f"{', '.join(sorted(closed))}",
        err=True,
    )
    return [record for record in records if record.id not in closed]
