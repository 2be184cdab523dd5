"""``gem compare``: two runs or more, paired by row."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from gem_eval.comparing.comparison import compare_with_first, default_metric
from gem_eval.comparing.sides import sides_of
from gem_eval.comparing.text import print_comparison, print_comparisons
from gem_eval.output import print_json

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
  gem compare runs/a runs/b runs/c                    each with the first
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
@click.option("--json", "as_json", is_flag=True, help="Write the comparisons as JSON, with all rows that flipped.")
def command(
    runs: tuple[str, ...], models: tuple[str, ...], metric: Metric | None, scores: str | None, as_json: bool
) -> None:
    """Compare runs, or models of one run, row by row.

    RUN is a folder that 'gem eval' wrote, or a file of 'gem run'; RUN@MODEL is one of its models. Of three or more,
    each is compared with the first.
    """
    sides = sides_of(runs, models, scores)
    comparisons = compare_with_first(sides, metric or default_metric(sides), scores)
    if as_json:
        print_json({"comparisons": [each.to_dict() for each in comparisons]})
    elif len(comparisons) > 1:
        print_comparisons(comparisons)
    else:
        print_comparison(comparisons[0])
