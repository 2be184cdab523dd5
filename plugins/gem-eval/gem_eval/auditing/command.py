"""``gem audit``: what is wrong with environments, before money is spent on them."""

from __future__ import annotations

import itertools
import json
from typing import TYPE_CHECKING

import click

from gem_core.cli import ENVS, arguments_option, env_arguments, find_envs, output_width
from gem_core.progress import Progress

if TYPE_CHECKING:
    from gem_eval.auditing.results import EnvAudit

_STEPS = 13
"""Steps of the audit of one environment."""


@click.command(
    "audit",
    epilog="""\b
Examples:
  gem audit math:Sample
  gem audit 'game:*' --limit 20
  gem audit math:GSM8K --set dataset_name=gsm8k.jsonl --set split=None --limit 200
  gem audit my:Tasks --threshold 0.02 --json
\b
Policies, and what is right for each:
  gold       the environment's own answers (gold_action, or the rows of a data set): all succeed
  random     valid random actions; echo: the observation; other: the gold answer of another row:
             no more than chance
  null       no answer; injection: words to a judge; hedge: many answers at once; peek: what info,
             observations and tools give away; tamper: code, patterns, false tests and reward files: none
\b
It also reads all rows of a data set, looks for gold answers in what an agent sees before the end, and
repeats episodes, which must come out the same. A note is no problem. Commands and programs that could do
harm are tried only after a harmless one has shown that a sandbox holds them.
\b
Exit code: 0 if all environments are sound, 1 if one has a problem above the threshold or could not
be audited, 2 for a wrong argument.
""",
)
@click.argument("ids", nargs=-1, required=True, type=ENVS, metavar="ID...")
@click.option("-n", "--limit", type=click.IntRange(min=1), default=50, show_default=True, help="Rows to play.")
@click.option(
    "-s", "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed that chooses the rows."
)
@click.option(
    "--threshold",
    type=click.FloatRange(0, 1),
    default=0.0,
    show_default=True,
    help="Share of rows or episodes up to which a problem passes.",
)
@arguments_option
@click.option("--json", "as_json", is_flag=True, help="Write what was found as JSON.")
@click.pass_context
def command(
    ctx: click.Context,
    /,
    ids: tuple[str, ...],
    limit: int,
    seed: int,
    threshold: float,
    arguments: tuple[str, ...],
    as_json: bool,
) -> None:
    """Check environments: gold answers succeed, exploits do not, rows are sound, nothing gives answers away.

    Each ID is an environment, a class in a file, a file of questions, a folder, or a glob in quotes such as 'game:*'. A
    glob leaves out games of several agents, and what cannot be made here. Prints a line for each environment, then its
    problems with examples.
    """
    from gem_eval.auditing.audit import audit
    from gem_eval.auditing.table import table_lines

    arguments_of_all = env_arguments(arguments)
    found: list[EnvAudit] = []
    chosen = find_envs(ids, several=False)
    with Progress(len(chosen) * _STEPS, "audit", unit="steps") as progress:
        for record, kwargs in chosen:
            steps = itertools.count(len(found) * _STEPS + 1)
            found += audit(
                record.id,
                limit=limit,
                seed=seed,
                kwargs={**kwargs, **arguments_of_all},
                on_done=lambda step, steps=steps: progress.advance(next(steps), step),  # type: ignore[misc]  # bound early
            )
    sound = not any(each.fails(threshold) for each in found)
    if as_json:
        environments = [each.to_dict() for each in found]
        click.echo(json.dumps({"threshold": threshold, "sound": sound, "environments": environments}, indent=1))
    else:
        for line in table_lines(found, threshold, output_width()):
            click.echo(line)
    ctx.exit(0 if sound else 1)
