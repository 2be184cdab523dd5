"""A comparison as a person reads it."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from gem_core.cli import Column, counted, echo_line, print_table, shown
from gem_eval import figures
from gem_eval.comparing.comparison import counted_tests
from gem_eval.show.text import one_line

if TYPE_CHECKING:
    from gem_eval.comparing.comparison import Comparison, Difference
    from gem_eval.comparing.sides import Side
    from gem_eval.scores import Metric

_MOST_FLIPS = 20
_TESTS = {"mcnemar": "McNemar's exact test", "permutation": "a permutation test by row"}


def print_comparison(comparison: Comparison) -> None:
    """Write two sides: the table, the verdict, what was left out, and what flipped."""
    _print_cautions([comparison])
    a, b = one_line(comparison.a.label), one_line(comparison.b.label)
    click.echo(f"A is {a}, B is {b}. Each row that both have is a pair.\n")
    several = len(comparison.tasks) > 1
    rows = [*comparison.tasks, comparison.overall] if several else comparison.tasks
    print_table(_columns(comparison, "task", corrected=several), rows)
    click.echo()
    for line in _verdict_lines(comparison):
        echo_line(line)
    for line in _flip_lines(comparison):
        click.echo(line)


def print_comparisons(comparisons: Sequence[Comparison]) -> None:
    """Write what each of several sides has over the first."""
    _print_cautions(comparisons)
    first = comparisons[0]
    click.echo(f"A is {one_line(first.a.label)}; each other run is a B, on the rows that both have.\n")
    print_table(
        _columns(first, "run", corrected=True),
        [replace(each.overall, id=each.b.label, p=each.overall.p_holm) for each in comparisons],
    )
    tests = " or ".join(dict.fromkeys(_TESTS[each.overall.test] for each in comparisons))
    corrected = _corrected_for([each.overall for each in comparisons], "pair")
    echo_line(f"\np by {tests}, corrected by Holm for {corrected}.")


def _flip_lines(comparison: Comparison) -> Iterator[str]:
    """Yield the lines of the rows that only one side solved, each with what shows both episodes."""
    flips, verdicts = comparison.flips, comparison.overall.only_a is not None
    if not flips:
        return
    yield f"\n{counted(len(flips), 'row')} {'that only one solved' if verdicts else 'that differ'}:"
    for flip in flips[:_MOST_FLIPS]:
        gain = figures.change(flip.b - flip.a, "return")
        change = ("only A" if flip.a > flip.b else "only B") if verdicts else gain
        one, other = flip.episode_a.number, flip.episode_b.number
        yield f"  {change}  {one_line(flip.row, 100)}  (episodes: A {one}, B {other})"
        yield f"    {_show_command(comparison.a, one)}; {_show_command(comparison.b, other)}"
    if len(flips) > _MOST_FLIPS:
        yield f"  … and {len(flips) - _MOST_FLIPS} more; --json lists them"


def _show_command(side: Side, number: int) -> str:
    return f"gem show {shlex.quote(str(side.run.path))} {number}"


def _columns(comparison: Comparison, named: str, *, corrected: bool) -> list[Column]:
    metric = _shown_as(comparison)

    def mean(row: Difference) -> str:
        return figures.change(None if row.difference is None else row.difference.mean, metric)

    def ends(row: Difference) -> str:
        return "-" if row.difference is None else figures.change_bounds(row.difference.low, row.difference.high, metric)

    columns = [
        Column(named, lambda row: one_line(row.id), name=True),
        Column("rows", lambda row: str(row.rows)),
        Column("A", lambda row: figures.score(row.a, metric)),
        Column("B", lambda row: figures.score(row.b, metric)),
        Column("B - A", mean),
        Column("95 % interval", ends),
        Column("p, corrected" if corrected else "p", lambda row: figures.p_value(row.shown_p)),
    ]
    if comparison.overall.only_a is not None:
        columns += [
            Column("only A", lambda row: shown(row.only_a, "d"), 1),
            Column("only B", lambda row: shown(row.only_b, "d"), 1),
        ]
    return columns


def _verdict_lines(comparison: Comparison) -> Iterator[str]:
    overall, metric = comparison.overall, _shown_as(comparison)
    if overall.difference is None or overall.p is None:
        yield "No row has a value on both sides, so nothing can be said."
    else:
        gain = figures.change(abs(overall.difference.mean), metric).removeprefix("+")
        unit = " points" if metric == "success" else ""
        tested = f"{_p_is(overall.p)} by {_TESTS[overall.test]}"
        if overall.verdict == "undecided":
            yield f"No significant difference in {_called(comparison)}: {tested}."
        else:
            better, worse = ("B", "A") if overall.verdict == "b" else ("A", "B")
            yield f"{better} has a higher {_called(comparison)} than {worse}, by {gain}{unit}: {tested}."
        if overall.more_rows:
            episodes = counted(overall.more_episodes or 0, "episode")
            yield (
                f"With about {counted(overall.more_rows, 'more row')} ({episodes} of each side), a true "
                "difference as large as this would be found with a probability of 80 %."
            )
    if comparison.without_cut_off is not None:
        other = comparison.without_cut_off
        said = {"a": "A is significantly better", "b": "B is significantly better"}.get(
            other.verdict, "there is no significant difference"
        )
        p = "" if other.p is None else f", {_p_is(other.p)}"
        yield f"Without the episodes that a limit cut off, {said} ({counted(other.rows, 'row')}{p})."
    if len(comparison.tasks) > 1:
        corrected = _corrected_for(comparison.tasks, "test")
        yield f"The p-values of tasks are corrected by Holm for {corrected}; that of all is one test."
    yield from _left_out_lines(comparison)


def _corrected_for(tested: Sequence[Difference], what: str) -> str:
    count = len(counted_tests(tested)[1])
    rest = len(tested) - count
    return counted(count, what) + (f" ({rest} more cannot reach 0.05, as too few of their rows differ)" if rest else "")


def _left_out_lines(comparison: Comparison) -> Iterator[str]:
    if comparison.only_a or comparison.only_b:
        only_a = counted(comparison.only_a, "row")
        yield f"Left out, as only one side has them: {only_a} of A, {comparison.only_b} of B."
    if comparison.left_out:
        yield f"Left out, as one side has no value for them: {counted(comparison.left_out, 'row')}."
    for what, (a, b) in {
        "Episodes with an error, left out": comparison.errors,
        "Unscored episodes, left out": comparison.unscored,
        "Episodes that a limit cut off, which count as not solved": comparison.cut_off,
    }.items():
        if a or b:
            if "cut off" in what and (comparison.metric == "return" or comparison.scores is not None):
                what = what.split(",")[0]
            yield f"{what}: {a} of A, {b} of B."


def _print_cautions(comparisons: Sequence[Comparison]) -> None:
    for each in comparisons:
        for caution in each.cautions:
            where = f"{each.a.label} and {each.b.label}"
            text = one_line(f"WARNING: {where} may not be comparable: {caution}")
            click.secho(text, err=True, fg="yellow", bold=True)


def _called(comparison: Comparison) -> str:
    if comparison.scores is not None:
        return f"score by {comparison.scores}"
    return "success rate" if comparison.metric == "success" else "mean return"


def _shown_as(comparison: Comparison) -> Metric:
    """Return how values are written: verdicts in percent, all else as numbers."""
    verdicts = comparison.overall.only_a is not None and comparison.metric == "success"
    return "success" if verdicts else "return"


def _p_is(value: float) -> str:
    return f"p {'' if value < 0.001 else '= '}{figures.p_value(value)}"
