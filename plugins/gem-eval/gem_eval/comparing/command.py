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
  gem compare runs/a runs/b runs/c                    each with the first
  gem compare runs/a runs/b --scores openai-gpt-5     by the scores of 'gem score'
\b
Rows that both runs have are paired. Other rows, errors and episodes without a verdict are counted and left
out. Success with one epoch of each row is tested by McNemar's exact test, everything else by a permutation
test of the signs of rows; several tasks, or pairs of runs, are corrected by Holm.
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
