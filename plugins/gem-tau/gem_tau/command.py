"""``gem tau``: checks the tasks in a data folder."""

from __future__ import annotations

import dataclasses
import json

import click

from gem_core.progress import Progress
from gem_tau.checking import Check, DroppedWrite, check_task
from gem_tau.folders import TaskSet, read_folder
from gem_tau.heatmap_command import heatmap


@click.group(
    "tau",
    epilog="\b\nExamples:\n  gem tau check tau_retail\n  gem tau check tau_retail --drop-one-write\n  gem tau heatmap",
)
def command() -> None:
    """Tasks of tau-bench and tau2-bench."""


command.add_command(heatmap)


@command.command(
    "check",
    epilog="""\b
Examples:
  gem tau check tau_retail
  gem tau check tau_retail --split test --drop-one-write
  gem tau check tau2-bench/data/tau2/domains/airline --json
""",
)
@click.argument("folder", type=click.Path())
@click.option("--split", help="Only the tasks of this split, such as test; without it, all in the folder.")
@click.option("--drop-one-write", is_flag=True, help="Also replay without each write in turn: that must get nothing.")
@click.option("--json", "as_json", is_flag=True, help="Write a line of JSON for each task, with its final hash.")
@click.pass_context
def check(ctx: click.Context, folder: str, split: str | None, drop_one_write: bool, as_json: bool) -> None:
    """Replay the reference actions of tasks: they must get reward 1.

    FOLDER holds the benchmark's files, of tau-bench's retail or tau2-bench's retail or airline; gem_tau:sample is the
    shop that comes with the plugin. The exit code is 1 where a task does not get 1, or still gets it without a write
    that changes the final database.
    """
    task_set = read_folder(folder, split)
    checks = []
    with Progress(len(task_set.tasks), "tasks", unit="tasks") as progress:
        for task in task_set.tasks:
            checks.append(check_task(task_set, task, drop_one_write=drop_one_write))
            progress.advance(len(checks))
    if as_json:
        for each in checks:
            click.echo(json.dumps(dataclasses.asdict(each)))
        for task_id, reason in task_set.left_out.items():
            click.echo(json.dumps({"task": task_id, "left_out": reason}))
    else:
        _print(task_set, checks, drop_one_write)
    if any(each.reward != 1 or _undetected(each) for each in checks):
        ctx.exit(1)


def _undetected(check: Check) -> list[DroppedWrite]:
    """Return the writes without which the reward is 1, although the final database is another."""
    return [each for each in check.dropped if each.effect == "final" and each.reward == 1]


def _print(task_set: TaskSet, checks: list[Check], drop_one_write: bool) -> None:
    failed = [each.task for each in checks if each.reward != 1]
    click.echo(f"{len(checks) - len(failed)} of {len(checks)} tasks get reward 1 by their reference actions")
    for task_id in failed:
        click.echo(f"  {task_id} does not")
    if drop_one_write:
        _print_dropped(checks)
    if task_set.left_out:
        click.echo(f"{len(task_set.left_out)} tasks are left out:")
        for task_id, reason in task_set.left_out.items():
            click.echo(f"  {task_id}: {reason}")
    click.echo(f"The assistant reads the tools' descriptions of {task_set.tools_from}")


def _print_dropped(checks: list[Check]) -> None:
    effective = sum(each.effect == "final" for check in checks for each in check.dropped)
    undetected = [(check.task, each) for check in checks for each in _undetected(check)]
    click.echo(f"{len(undetected)} of {effective} still do with one write left out")
    for task_id, each in undetected:
        click.echo(f"  {task_id} without action {each.position}, {each.name}")
    others = [(check.task, each) for check in checks for each in check.dropped if each.effect != "final"]
    if others:
        click.echo(
            f"{len(others)} more writes make no difference to the final database, so that no reward can see them:"
        )
    for task_id, each in others:
        why = "the other actions lead there too" if each.effect == "redundant" else each.error or "nothing is new in it"
        click.echo(f"  {task_id}, action {each.position}, {each.name}: {why}")
