"""``gem audit``: what is wrong with environments, before money is spent on them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

import gem_core
from gem_core.cli import (
    AGENTS,
    ENVS,
    agent_options,
    arguments_option,
    env_arguments,
    find_env,
    given,
    matching,
    output_width,
)
from gem_core.errors import GemError
from gem_core.progress import Progress

if TYPE_CHECKING:
    from gem_core.registry import EnvSpec
    from gem_eval.auditing.results import EnvAudit

_STEPS = 14
"""Steps of the audit of one environment."""


@click.command(
    "audit",
    epilog="""\b
Examples:
  gem audit math:Sample
  gem audit 'game:*' --limit 20
  gem audit math:GSM8K --set dataset_name=gsm8k.jsonl --set split=None --limit 200
  gem audit my:Tasks --against my:Tasks-train --against train.jsonl
  gem audit my:Tasks --threshold 0.02 --json
  gem audit my:Tasks --model openai:gpt-5-mini --max-tokens 2000
\b
Policies, and what is right for each:
  gold       the environment's own answers (gold_action, or the rows of a data set): all succeed
  random     valid random actions; echo: the observation; other: the gold answer of another row:
             no more than chance
  null       no answer; injection: words to a judge; hedge: many answers at once; peek: what info,
             observations and tools give away; tamper: code, patterns, false tests and reward files: none
\b
It also reads all rows of a data set: gold answers that are missing or malformed, questions that
occur twice, and with --against rows of another set. It looks for gold answers in what an agent sees
before the end, calls each tool once, and repeats episodes, which must come out the same. A note is
no problem.
\b
Commands and programs that could do harm are tried only after a harmless one has shown that a sandbox
holds them.
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
@click.option(
    "--against",
    multiple=True,
    type=ENVS,
    metavar="ID|FILE",
    help="Rows that the environments must not have, as a test set's. Can be repeated.",
)
@click.option(
    "--model", type=AGENTS, metavar="AGENT", help="Also count a model's responses in which no answer is found."
)
@arguments_option
@click.option("--json", "as_json", is_flag=True, help="Write what was found as JSON.")
@agent_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    ids: tuple[str, ...],
    limit: int,
    seed: int,
    threshold: float,
    against: tuple[str, ...],
    model: str | None,
    arguments: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> None:
    """Check environments: gold answers succeed, exploits do not, rows are sound, nothing gives answers away.

    Each ID is an environment, a class in a file, a file of questions, a folder, or a glob in quotes such as 'game:*'. A
    glob leaves out games of several agents, and what cannot be made here. Prints a line for each environment, then its
    problems with examples.
    """
    from gem_eval.auditing.audit import audit
    from gem_eval.auditing.model import count_unreadable
    from gem_eval.auditing.table import table_lines

    kwargs = env_arguments(arguments)
    found: list[EnvAudit] = []
    chosen = _chosen(ids, env_arguments(arguments))
    with Progress(len(chosen) * _STEPS, "audit", unit="steps") as progress:
        done = 0

        def on_done(step: str) -> None:
            nonlocal done
            done += 1
            progress.advance(done, step)

        for number, (env_id, kwargs) in enumerate(chosen):
            found += audit(env_id, limit=limit, seed=seed, kwargs=kwargs, against=against, on_done=on_done)
            if model is not None and not found[-1].failure:
                count_unreadable(found[-1], model, given(options), kwargs, limit=limit, seed=seed)
            done = (number + 1) * _STEPS
    sound = not any(each.fails(threshold) for each in found)
    if as_json:
        environments = [each.to_dict() for each in found]
        click.echo(json.dumps({"threshold": threshold, "sound": sound, "environments": environments}, indent=1))
    else:
        for line in table_lines(found, threshold, output_width()):
            click.echo(line)
    ctx.exit(0 if sound else 1)


def _chosen(ids: tuple[str, ...], arguments: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Return the ids that were meant, each once and with its keyword arguments."""
    chosen: dict[str, dict[str, Any]] = {}
    for each in ids:
        if any(character in each for character in "*?["):
            chosen |= {record.id: dict(arguments) for record in _makeable(matching(each), arguments)}
        else:
            record, own = find_env(each)
            chosen[record.id] = {**own, **arguments}
    return list(chosen.items())


def _makeable(records: Sequence[EnvSpec], arguments: Mapping[str, Any]) -> list[EnvSpec]:
    """Return the records of a glob that can be made here and are for one agent, and say which are left out."""
    kept: list[EnvSpec] = []
    out_of_reach = False
    for record in records:
        from_hub = "hub" in record.requires
        if record.seats or (from_hub and out_of_reach):
            continue
        try:
            if record.requires:
                gem_core.make(record.id, **arguments).close()
        except GemError:
            out_of_reach = out_of_reach or from_hub  # to look for each of its data sets takes half a minute
            continue
        kept.append(record)
    left_out = [record.id for record in records if record not in kept]
    if left_out and kept:
        why = "for several agents, or not to be made here ('gem info ID' says why)"
        click.echo(f"gem: left out {len(left_out)} of {len(records)}, {why}: {', '.join(left_out)}", err=True)
    return kept or list(records)
