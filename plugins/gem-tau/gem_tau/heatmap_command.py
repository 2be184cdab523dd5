"""``gem tau heatmap``: how often each assistant succeeds with each user, as a table and as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import click

from gem_core.cli import Column, print_table
from gem_core.errors import ArgumentError
from gem_core.records import EnvSummary
from gem_tau import scripted_assistants, scripted_users
from gem_tau.heatmap import heat_map, percent, plain_rows

_USERS = ",".join(f"tau-user:{name}" for name in scripted_users.CHARACTERS)
_ASSISTANTS = ",".join(f"tau-assistant:{name}" for name in scripted_assistants.CHARACTERS)


@click.command(
    "heatmap",
    epilog="""\b
Examples:
  gem tau heatmap
  gem tau heatmap --out heatmap.json
  gem tau heatmap --ids tau:Retail-test --folder tau_retail --users openai:A,openai:B --assistants openai:A,openai:B
""",
)
@click.option("--ids", default="tau:Sample", show_default=True, help="Environments, joined by commas.")
@click.option(
    "--users", default=_USERS, show_default=True, help="Agents at the user's seat, joined by commas: the rows."
)
@click.option(
    "--assistants", default=_ASSISTANTS, show_default=True, help="Agents at the assistant's seat: the columns."
)
@click.option("--folder", type=click.Path(path_type=Path), help="Data of the environments that need a folder.")
@click.option(
    "-n",
    "--episodes",
    type=click.IntRange(min=1),
    help="Episodes of each cell and environment.  [default: each task once]",
)
@click.option("-s", "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of every cell.")
@click.option("-k", "--num-envs", type=click.IntRange(min=1), help="Episodes at once.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Write the cells too, as JSON.")
@click.pass_context
def heatmap(
    ctx: click.Context,
    ids: str,
    users: str,
    assistants: str,
    folder: Path | None,
    episodes: int | None,
    seed: int,
    num_envs: int | None,
    out: Path | None,
) -> None:
    """Let each assistant serve each user, and print how often it succeeds.

    A row for each user, a column for each assistant: success in percent with its standard error (Wilson's), and the
    number of episodes. Episodes with an error are in no rate, and make the exit code 1. An agent is named as for gem
    run; openai:MODEL takes the address of its server from OPENAI_BASE_URL.
    """
    rows = heat_map(
        _names(ids, "--ids"),
        _names(users, "--users"),
        _names(assistants, "--assistants"),
        episodes=episodes,
        seed=seed,
        num_envs=num_envs,
        arguments=None if folder is None else {"folder": str(folder)},
    )
    _print(rows)
    if out is not None:
        out.write_text(json.dumps(plain_rows(rows), indent=1) + "\n", encoding="utf-8")
        click.echo(f"{out} written")
    if any(cell.errors for row in rows for cell in row):
        ctx.exit(1)


def _names(given: str, option: str) -> list[str]:
    names = [name.strip() for name in given.split(",") if name.strip()]
    if not names:
        raise ArgumentError(f"{option} names nothing")
    return names


def _print(rows: list[list[EnvSummary]]) -> None:
    columns = [Column("user", lambda row: str(row[0].id), name=True)]
    for place, cell in enumerate(rows[0]):
        columns.append(Column(str(cell.agent), lambda row, place=place: _figures(row[place])))  # type: ignore[misc]
    click.echo("Success of the assistant in %, ± standard error, and the number of episodes")
    print_table(columns, rows)


def _figures(cell: EnvSummary) -> str:
    failed = f", {cell.errors} failed" if cell.errors else ""
    return f"{percent(cell)} ({cell.judged}{failed})"
