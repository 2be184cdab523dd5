"""``gem compare``: two runs or more, paired by row."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean
from gem_eval.comparing.comparison import Comparison, Flip, compare_all, default_metric
from gem_eval.comparing.sides import sides_of
from gem_eval.comparing.text import flip_lines, print_comparison, print_matrix
from gem_eval.output import print_json
from gem_eval.show.diff import diff_lines
from gem_eval.show.lines import episode_lines
from gem_eval.show.paging import write_lines
from gem_eval.show.text import one_line, rule

if TYPE_CHECKING:
    from gem_eval.scores import Metric


@click.command(
    "compare",
    epilog="""\b
Examples:
  gem compare runs/before runs/after                  the difference, its interval, a test, what flipped
  gem compare runs/both                               the models of one run
  gem compare runs/both@openai:gpt-5-mini runs/other  one model of a run, and another run
  gem compare runs/a runs/b --metric return
  gem compare runs/a runs/b --flip math:GSM8K/17      both transcripts of a row
  gem compare runs/a runs/b runs/c                    a matrix of differences
  gem compare runs/a runs/b --scores openai-gpt-5     by the scores of 'gem score'
\b
Rows that both runs have are paired: a row is a task of an environment, and the same in every run with the
same seed. Other rows, errors and episodes without a verdict are counted and left out. An episode that a
limit cut off is not solved; if leaving these out changes the verdict, a line says so.
\b
Success with one epoch of each row is tested by McNemar's exact test, everything else by a permutation
test that gives each row's difference a random sign. Where several tasks, or several pairs of runs, are
tested, p-values are corrected by Holm; tests that cannot reach 0.05, as too few of their rows
differ, are left out of the count (Tarone).
""",
)
@click.argument("runs", metavar="RUN…", nargs=-1, required=True, type=click.Path())
@click.option(
    "-m", "--model", "models", multiple=True, metavar="NAME", help="Take this model of every run; can be repeated."
)
@click.option(
    "--metric", type=click.Choice(["success", "return"]), help="What is compared.  [default: success, if told]"
)
@click.option("--scores", metavar="NAME", help="Compare by these scores of 'gem score'.")
@click.option("--flip", metavar="ROW", help="Show both transcripts of a row.")
@click.option("--diff", is_flag=True, help="With --flip: show where the two differ.")
@click.option("--all", "every", is_flag=True, help="List all rows that flipped, not only the first 20.")
@click.option("--json", "as_json", is_flag=True, help="Write the comparisons as JSON.")
def command(
    runs: tuple[str, ...],
    models: tuple[str, ...],
    metric: Metric | None,
    scores: str | None,
    flip: str | None,
    diff: bool,
    every: bool,
    as_json: bool,
) -> None:
    """Compare runs, or models of one run, row by row.

    RUN is a folder that 'gem eval' wrote, or a file of 'gem run'; RUN@MODEL is one of its models.
    """
    if diff and flip is None:
        raise ArgumentError("--diff goes with --flip ROW; 'gem compare' lists the rows")
    sides = sides_of(runs, models, scores)
    if flip is not None and len(sides) > 2:
        raise ArgumentError(f"--flip shows two episodes, and {len(sides)} runs are given: give two")
    comparisons = compare_all(sides, metric or default_metric(sides), scores)
    first = comparisons[0]
    if flip is not None:
        write_lines(_flip_transcripts(first, _find(first, flip), diff=diff))
    elif as_json:
        print_json({"comparisons": [each.to_dict() for each in comparisons]})
    elif len(sides) > 2:
        print_matrix(sides, comparisons)
    else:
        print_comparison(first)
        for line in flip_lines(first, every=every):
            click.echo(line)


def _find(comparison: Comparison, row: str) -> Flip:
    """Return the episodes of a row that both sides have: those that flipped, or else the first of each."""
    for flip in comparison.flips:
        if flip.row == row:
            return flip
    a, b = (side.by_task(comparison.metric) for side in (comparison.a, comparison.b))
    both = {task[1]: task for task in a if task in b and a[task].rows and b[task].rows}
    if row not in both:
        raise ArgumentError(f"the two share no row {one_line(row)!r} with a value.{did_you_mean(row, list(both))}")
    one, other = a[both[row]], b[both[row]]
    return Flip(both[row][0], row, one.mean, other.mean, one.rows[0], other.rows[0])


def _flip_transcripts(comparison: Comparison, flip: Flip, *, diff: bool) -> Iterator[str]:
    """Yield the lines of both episodes of a row: one after the other, or where they part."""
    one = comparison.a.run.episode(flip.episode_a)
    other = comparison.b.run.episode(flip.episode_b)
    if diff:
        yield from diff_lines((flip.episode_a.number, flip.episode_b.number), (one, other))
        return
    for name, side, row, episode in (
        ("A", comparison.a, flip.episode_a, one),
        ("B", comparison.b, flip.episode_b, other),
    ):
        yield rule(f"{name}: {side.label}")
        yield from episode_lines(episode, row.number)
        yield ""
