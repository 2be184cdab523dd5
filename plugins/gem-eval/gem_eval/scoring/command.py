"""``gem score``: grade a run again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TextIO

import click

from gem_core.cli import Column, agent_options, arguments_option, counted, echo_line, env_arguments, given, print_table
from gem_core.errors import ArgumentError
from gem_core.progress import Progress
from gem_eval import figures
from gem_eval.opening import warn_of_damage
from gem_eval.output import print_json
from gem_eval.records import open_run
from gem_eval.scoring.grading import Rescored, TaskScore, score
from gem_eval.show.text import one_line

if TYPE_CHECKING:
    from gem_eval.statistics import Estimate

_MOST_LISTED = 20


@click.command(
    "score",
    epilog="""\b
Examples:
  gem score runs/mine --grader my_module:grade         a function of your own
  gem score runs/mine --grader env                     the environment's grading, as it is now
  gem score runs/mine --grader openai:gpt-5-mini --rubric rubric.txt --name polite
  gem compare runs/mine runs/other --scores polite
\b
Your own grader gets a gem.Episode, and returns True or False, a number, several by name
({"polite": 1, "short": 0.5}; the first is compared), or None if it cannot tell. It may be a coroutine
function. The scores are written beside the run, which is never changed. The same command goes on after
Ctrl-C, and tries again where the grader failed.
\b
Exit code: 0 if the grader failed for no episode, 1 if it did, 2 for a wrong argument, 130 after Ctrl-C.
""",
)
@click.argument("path", metavar="RUN", type=click.Path())
@click.option(
    "-g", "--grader", required=True, metavar="GRADER", help="MODULE:FUNCTION, 'env', or 'openai:MODEL' for a judge."
)
@click.option("--name", help="Name of the scores.  [default: the grader's]")
@click.option(
    "--rubric",
    metavar="FILE",
    type=click.File("r", encoding="utf-8"),
    help="File that says what makes an episode pass.",
)
@arguments_option
@click.option("--overwrite", is_flag=True, help="Grade all episodes again.")
@click.option("--json", "as_json", is_flag=True, help="Write the scores as JSON.")
@agent_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    path: str,
    grader: str,
    name: str | None,
    rubric: TextIO | None,
    arguments: tuple[str, ...],
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Grade the episodes of a run again, without playing them again.

    RUN is a folder that 'gem eval' wrote, or a file of 'gem run'.
    """
    of_model = given(options)
    limit = of_model.get("max_concurrency") if grader.startswith("openai:") else of_model.pop("max_concurrency", None)
    if "system" in of_model:
        raise ArgumentError("the judge has a system prompt of its own; say what makes an episode pass by --rubric FILE")
    with Progress(None, "episodes graded") as bar:
        found = score(
            open_run(path),
            grader,
            name=name,
            rubric=None if rubric is None else rubric.read(),
            kwargs=env_arguments(arguments),
            options=of_model,
            max_concurrency=limit,
            overwrite=overwrite,
            on_graded=lambda done, total: bar.advance(done, f"of {total}"),
        )
    if as_json:
        print_json(_as_dict(found))
    else:
        _report(found)
    ctx.exit(1 if found.errors else 0)


def _report(found: Rescored) -> None:
    columns = [
        Column("task", lambda row: one_line(row.id), name=True),
        Column("model", lambda row: one_line(row.model) or "-", 0),
        Column("graded", lambda row: str(row.episodes)),
        Column("old [95 %]", lambda row: _shown(row.old)),
        Column("new [95 %]", lambda row: _shown(row.new)),
        Column("changed", lambda row: str(row.changed)),
        Column("cannot tell", lambda row: str(row.unknown)),
        Column("errors", lambda row: str(row.errors), alarm=True),
    ]
    print_table(columns, found.tasks)
    click.echo()
    warn_of_damage(found.run)
    if found.not_graded:
        echo_line(f"{counted(found.not_graded, 'episode')} ended in an error, and cannot be graded.")
    notes = {number: each.note or "" for number, each in found.graded.items()}
    differing = {number: note for number, note in notes.items() if note.startswith("not as recorded")}
    verdicts = {each.row.number: f"{'passes' if each.new else 'fails'} now  {each.row.row}" for each in found.changed}
    for title, told in (
        (f"{counted(len(differing), 'replay')} went another way than recorded:", differing),
        (f"The grader failed {counted(len(found.errors), 'time')}; the same command tries again:", found.errors),
        (f"{counted(len(verdicts), 'verdict')} changed:", verdicts),
    ):
        if told:
            echo_line(title)
        for number, words in list(told.items())[:_MOST_LISTED]:
            click.echo(f"  episode {number}: {one_line(words, 200)}")
        if len(told) > _MOST_LISTED:
            click.echo(f"  … and {len(told) - _MOST_LISTED} more; --json lists them")
    echo_line(f"Written to {found.path}; compare runs by these scores with --scores {found.name}.")


def _shown(estimate: Estimate | None) -> str:
    return figures.with_bounds(estimate, "success" if estimate is None or 0 <= estimate.mean <= 1 else "return")


def _as_dict(found: Rescored) -> dict[str, Any]:
    def task(each: TaskScore) -> dict[str, Any]:
        estimates = {"old": each.old, "new": each.new}
        return {**vars(each), **{name: own and own._asdict() for name, own in estimates.items()}}

    return {
        "name": found.name,
        "path": str(found.path),
        "scores": [task(each) for each in found.tasks],
        "changed": [
            {"episode": each.row.number, "row": each.row.row, "old": each.old, "new": each.new}
            for each in found.changed
        ],
        "errors": [{"episode": number, "error": error} for number, error in found.errors.items()],
        "not_graded": found.not_graded,
    }
