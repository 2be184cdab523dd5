"""The sections with scores: tables with intervals as plots, and the differences of those that share rows."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gem_core.cli import shown
from gem_eval import figures
from gem_eval.reporting import plots
from gem_eval.reporting.lines import Line, lined_table, lines, task_name
from gem_eval.reporting.markup import Cell, name_cell, section, table, text

if TYPE_CHECKING:
    from gem_eval.reporting.contents import Contents, Paired
    from gem_eval.scores import Metric, Score

_COUNTS = {"truncated": "Cut off", "unreadable": "Unreadable", "unscored": "Unscored", "errors": "Errors"}


def scores(contents: Contents) -> str:
    """Return the tables of scores."""
    success = contents.tasks_with("success")
    # Where a task pays 1 for success and 0 for failure, its returns say nothing more.
    apart = [task for task in contents.tasks_with("return") if not _is_success(contents, task)]
    tables = []
    if success:
        note = "Share of episodes that solved their task, in percent. The line is the 95 % interval."
        tables.append(f'<p class="soft">{note}</p>' + _score_table(contents, success, "success"))
    if apart:
        note = "Sum of the rewards of an episode; the line is the 95 % interval. Each task has a scale of its own."
        tables.append(f'<h3>Returns</h3><p class="soft">{note}</p>' + _score_table(contents, apart, "return"))
    return section("scores", "Scores", *tables, _sensitivity(contents, success))


def pass_table(contents: Contents, tasks: Sequence[str]) -> str:
    """Return pass@k and pass^k; empty where rows have one epoch."""
    chosen = list(lines(contents, tasks, "success"))
    ks = sorted({int(k) for line in chosen for k in _score(line, "success").pass_at if int(k) > 1})
    if not ks:
        return ""

    def cells(line: Line) -> list[Cell]:
        score = _score(line, "success")
        found = [each.get(str(k)) for each in (score.pass_at, score.pass_hat) for k in ks]
        means = [score.mean, *(each.mean if each else None for each in found)]
        return [Cell(figures.score(each, "success")) for each in means]

    headers = [Cell("Mean"), *(Cell(f"pass@{k}") for k in ks), *(Cell(f"pass^{k}") for k in ks)]
    note = "pass@k: the probability that at least one of k tries solves a row; pass^k: that all do. "
    note += " ".join(text(figures.pass_note(_score(line, "success"))) for line in chosen)
    return f'<h3>pass@k</h3><p class="soft">{note}</p>{lined_table(contents, chosen, headers, cells)}'


def differences(contents: Contents) -> str:
    """Return the paired differences; empty where no two models share rows."""
    if not contents.differences:
        return ""
    metrics = dict.fromkeys(each.metric for each in contents.differences)
    tables = [_difference_table([e for e in contents.differences if e.metric == m], m) for m in metrics]
    note = "Only rows that both played, each as a pair: what makes a row hard for both does not count. "
    note += "p is the probability of a difference this large if the two were alike; of several tasks it is "
    note += "corrected by Holm, as 'gem compare' has it."
    if not contents.paired_by_task:
        note += f" All {len(contents.tasks)} tasks together."
    return section("differences", "Differences", f'<p class="soft">{note}</p>', *tables)


def _score_table(contents: Contents, tasks: Sequence[str], metric: Metric) -> str:
    # Returns of different tasks are of different sizes, and have no mean.
    chosen = list(lines(contents, tasks, metric, with_all=metric == "success"))
    counts = [name for name in _COUNTS if name == "errors" or any(getattr(_score(e, metric), name) for e in chosen)]

    def cells(line: Line) -> list[Cell]:
        score = _score(line, metric)
        scale = plots.SHARES if metric == "success" else _return_scale(contents, line.task)
        axis = plots.axis(scale) if metric == "return" and line.span else ""
        told = [figures.bounds(score.low, score.high, metric), score.episodes, score.rows]
        told += [getattr(score, name) for name in counts]
        plot = Cell(axis + _interval(score, line, scale), "plot")
        return [plot, Cell(figures.score(score.mean, metric), "number main"), *(Cell(str(each)) for each in told)]

    headers = [Cell(plots.axis(plots.SHARES) if metric == "success" else "", "plot")]
    titles = ["Success" if metric == "success" else "Return", "95 % interval", "Episodes", "Rows"]
    headers += [Cell(title) for title in (*titles, *(_COUNTS[name] for name in counts))]
    return lined_table(contents, chosen, headers, cells)


def _sensitivity(contents: Contents, tasks: Sequence[str]) -> str:
    """Return what the scores would be if episodes whose count is debatable counted otherwise; empty where the same."""
    chosen = []
    for line in lines(contents, tasks, "success"):
        whole = line.task == "all" or len(tasks) == 1
        if whole and any(each is not None for each in _otherwise(_score(line, "success"))):
            chosen.append(line._replace(span=1))
    if not chosen:
        return ""

    def cells(line: Line) -> list[Cell]:
        score = _score(line, "success")
        return [Cell(figures.score(each, "success")) for each in (score.mean, *_otherwise(score))]

    titles = ("As counted", "Cut off left out", "Unreadable left out", "Errors as failures", "Unscored as failures")
    note = "Episodes whose count is debatable, counted otherwise. A dash: the score stays the same."
    shown = lined_table(contents, chosen, [Cell(title) for title in titles], cells)
    return f'<h3>Counted otherwise</h3><p class="soft">{note}</p>{shown}'


def _otherwise(score: Score) -> list[float | None]:
    without = [None if each is None else each.mean for each in (score.without_truncated, score.without_unreadable)]
    return [*without, score.with_errors, score.with_unscored]


def _difference_table(found: Sequence[Paired], metric: Metric) -> str:
    ends = [end for each in found for end in (each.estimate.mean, each.estimate.low, each.estimate.high)]
    scale = plots.Scale.of([0.0, *(end for end in ends if end is not None)], 4, percent=metric == "success")
    rows = []
    for compared, group in itertools.groupby(found, lambda e: f"{e.second.label} minus {e.first.label}"):
        own = list(group)
        for place, each in enumerate(own):
            mean, _, low, high = each.estimate
            plot = plots.interval(mean, low, high, scale, each.second.place, f"{compared}: {mean:+.3g}")
            told = [figures.change(mean, metric), figures.change_bounds(low, high, metric), str(each.found.rows)]
            told += [shown(each.found.only_b, "d"), shown(each.found.only_a, "d"), figures.p_value(each.found.shown_p)]
            names = [] if place else [name_cell(compared, span=len(own))]
            cells = [*names, name_cell(task_name(each.found.id)), Cell(plot, "plot"), *map(Cell, told)]
            rows.append(("again" if place else "", cells))
    unit = "Points" if metric == "success" else "Difference"
    headers = [Cell("Compared", "name"), Cell("Task", "name"), Cell(plots.axis(scale), "plot")]
    headers += [Cell(each) for each in (unit, "95 % interval", "Rows", "Only it solved", "Only the other", "p")]
    return table(headers, rows)


def _score(line: Line, metric: Metric) -> Score:
    return line.entrant.scores[line.task, metric]


def _interval(score: Score, line: Line, scale: plots.Scale) -> str:
    if score.mean is None:
        return plots.no_interval(scale)
    told = f"{line.entrant.label}: {figures.score(score.mean, score.metric)}"
    return plots.interval(score.mean, score.low, score.high, scale, line.entrant.place, told)


def _return_scale(contents: Contents, task: str) -> plots.Scale:
    found = [entrant.scores.get((task, "return")) for entrant in contents.entrants]
    ends = [end for each in found if each is not None for end in (each.mean, each.low, each.high) if end is not None]
    return plots.Scale.of(ends, 4)


def _is_success(contents: Contents, task: str) -> bool:
    """Whether the return of every episode of a task is 1 for success and 0 for failure."""
    rows = [row for entrant in contents.entrants for row in entrant.of_task(task) if row.error is None]
    return all(row.success is not None and row.episode_return == float(row.success) for row in rows)
