"""``gem terminal list``: tasks, what they ask for, and what cannot run here."""

from __future__ import annotations

import json
from typing import Any

import click

from gem_core.cli import Column, print_table
from gem_terminal.command.asking import chosen_backend, chosen_limits, paths_of, shared_options, why_not
from gem_terminal.errors import EngineError
from gem_terminal.selecting import read_tasks


def _with_unit(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.15g} {unit}"


_COLUMNS = (
    Column("task", lambda row: row["name"], name=True),
    Column("format", lambda row: row["format"], text=True),
    Column("difficulty", lambda row: row["difficulty"] or "-", text=True),
    Column("agent", lambda row: _with_unit(row["agent_s"], "s"), dispensable=0),
    Column("tests", lambda row: _with_unit(row["tests_s"], "s"), dispensable=1),
    Column("memory", lambda row: _with_unit(row["memory_mb"], "MB"), dispensable=2),
    Column("network", lambda row: row["network"], text=True),
    Column("here", lambda row: "no" if row["cannot_run"] else "yes", text=True),
)


@click.command(
    "list",
    epilog="""\b
Examples:
  gem terminal list
  gem terminal list my-tasks more-tasks
  gem terminal list my-tasks --json
""",
)
@shared_options
@click.option("--json", "as_json", is_flag=True, help="Write one JSON list, with all that is known of each.")
def command(
    where: tuple[str, ...],
    variables: tuple[str, ...],
    build_args: tuple[str, ...],
    as_json: bool,
    **most: Any,
) -> None:
    """Show tasks: format, difficulty, limits, what cannot run here and why, what has no effect, what a task lacks.

    PATH is a task's folder or a folder of tasks; an ID is one such as terminal:Sample, which is the default.
    """
    found, limits = read_tasks(paths_of(where), variables), chosen_limits(**most)
    try:
        backend, missing = chosen_backend(build_args), ""
    except EngineError as error:
        backend, missing = None, str(error)
    rows: list[dict[str, Any]] = [
        {
            "name": task.name,
            "format": task.format,
            "difficulty": task.difficulty,
            "category": task.category,
            "tags": list(task.tags),
            "steps": len(task.steps),
            "services": list(task.environment.services),
            "cpus": task.environment.main.cpus,
            "memory_mb": task.environment.main.memory_mb,
            "storage_mb": task.environment.main.storage_mb,
            "network": task.environment.network or "none",
            "agent_s": task.steps[0].agent_timeout_s,
            "tests_s": task.steps[0].verifier.timeout_s,
            "folder": str(task.folder),
            "digest": task.digest,
            "notes": list(task.notes),
            "shortfall": limits.shortfall(task, backend.resources()) if backend else [],
            "cannot_run": why_not(backend, task) if backend else missing,
        }
        for task in found.tasks
    ]
    broken = {each.name: str(each.error) for each in found.broken}
    if as_json:
        click.echo(json.dumps([*rows, *({"name": name, "broken": why} for name, why in broken.items())], indent=1))
        return
    print_table(_COLUMNS, rows)
    told: dict[str, list[str]] = {}
    for row in rows:
        for why in filter(None, (row["cannot_run"], *row["notes"], *row["shortfall"])):
            told.setdefault(why, []).append(row["name"])
    for why, names in told.items():
        _echo(f"{names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}", why)
    for name, why in broken.items():
        _echo(f"{name}: cannot be read", why)


def _echo(what: str, why: str) -> None:
    click.echo(f"{what}: {' '.join(why.split())}")
