"""What an audit prints: a line for each environment, then the problems with examples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import click

from gem_core.cli import Column, wrapped
from gem_core.cli import table_lines as lines_of_table
from gem_eval.auditing.results import KINDS, EnvAudit, Problem
from gem_eval.show.text import one_line

_LEGEND = (
    "Solved of episodes. gold: all should be. random, echo (the observation), other (the gold answer of another row): "
    "no more than chance, which is how often the most frequent answer is right. null, injection, hedge (many answers "
    "at once), peek (what info and observation give away), tamper: none."
)
_MOST_IN_FULL = 200


def table_lines(found: Sequence[EnvAudit], threshold: float, width: int | None) -> Iterator[str]:
    """Yield the table, and below it what is wrong with each environment.

    Args:
        found: What was found.
        threshold: Share above which a problem counts.
        width: Characters in a line; None for any number.
    """
    ranks = {"other": 2, "echo": 3}
    columns = [
        Column("environment", lambda each: str(each.id), name=True),
        Column("rows", lambda each: str(each.rows), 0),
        *(Column(policy, partial(_rate, policy), ranks.get(policy)) for policy in KINDS),
        Column("chance", lambda each: "-" if each.chance is None else f"{each.chance:.0%}", 1),
        Column(
            "problems",
            lambda each: _problems(each, threshold),
            colour=lambda each: "red" if each.fails(threshold) else "",
        ),
    ]
    yield from lines_of_table(columns, found, width)
    yield from wrapped(_LEGEND, width)
    unknown = [each.id for each in found if any(problem.kind == "unknown" for problem in each.problems)]
    if unknown:
        yield f"No gold answers are known (gold_action() returns None): {', '.join(unknown)}"
    for each in found:
        yield from _details(each, threshold)


def _rate(policy: str, found: EnvAudit) -> str:
    rate = found.rates.get(policy)
    return "-" if rate is None or not rate.episodes else f"{rate.solved}/{rate.episodes}"


def _problems(found: EnvAudit, threshold: float) -> str:
    count = sum(each.fails and each.share > threshold for each in found.problems)
    return "not audited" if found.failure else str(count) if count else "none"


def _details(found: EnvAudit, threshold: float) -> Iterator[str]:
    problems = [each for each in found.problems if each.kind != "unknown"]
    if not found.failure and not problems:
        return
    yield ""
    yield click.style(found.id, fg="cyan")
    if found.failure:
        yield f"  not audited: {one_line(found.failure, _MOST_IN_FULL)}"
    for problem in sorted(problems, key=lambda each: (not each.fails, -each.share)):
        yield from _problem_lines(problem, threshold)


def _problem_lines(problem: Problem, threshold: float) -> Iterator[str]:
    counts = problem.fails and problem.share > threshold
    mark = click.style("problem", fg="red") if counts else "within the threshold" if problem.fails else "note"
    yield f"  {mark}: {one_line(problem.message, 2 * _MOST_IN_FULL)}"
    for example in problem.examples:
        yield f"    {one_line(example, _MOST_IN_FULL + 100)}"
