"""A report as Markdown: tables that stand in a pull request or a paper."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from gem_eval import figures
from gem_eval.reporting.page import summary
from gem_eval.show.text import one_line

if TYPE_CHECKING:
    from gem_eval.reporting.contents import Contents

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|~&!@])")
_LONGEST_NAME = 120


def markdown_report(contents: Contents) -> str:
    """Return a report as Markdown: the scores, and the differences of those that share rows."""
    title = " and ".join(run.name for run in contents.runs)
    lines = [f"### {_text(title)}", "", summary(contents)]
    if contents.rows:
        lines += ["", *_score_lines(contents)]
    if contents.differences:
        lines += ["", *_difference_lines(contents)]
    lines += [
        "",
        "Intervals cover 95 %, clustered by row. Errors are left out of scores; cut-off episodes count as not solved.",
    ]
    return "\n".join(lines) + "\n"


def _score_lines(contents: Contents) -> Iterable[str]:
    metrics = {task: contents.main_metric(task) for task in contents.tasks}
    told = [task for task in contents.tasks if metrics[task] == "success"]
    # Returns of different tasks are of different sizes, and have no sum.
    lines = [(task, metric) for task, metric in metrics.items()] + ([("all", "success")] if len(told) > 1 else [])
    found = []
    for task, metric in lines:
        for entrant in contents.entrants:
            if score := entrant.scores.get((task, metric)):
                name = "**all tasks**" if task == "all" else _text(task)
                shown = figures.score(score.mean, metric)
                interval = figures.bounds(score.low, score.high, metric)
                kind = "success" if metric == "success" else "return"
                counts = [score.episodes, score.rows, score.truncated, score.errors]
                found.append([name, _text(entrant.label), kind, shown, interval, *map(str, counts)])
    headers = ["Task", "Model", "Score", "Mean", "95 % interval", "Episodes", "Rows", "Cut off", "Errors"]
    return _table(headers, found, left=3)


def _difference_lines(contents: Contents) -> Iterable[str]:
    found = []
    for each in contents.differences:
        name = "**all tasks**" if each.found.id == "all" else _text(each.found.id)
        compared = f"{_text(each.second.label)} minus {_text(each.first.label)}"
        mean, _, low, high = each.estimate
        told = [figures.change(mean, each.metric), figures.change_bounds(low, high, each.metric)]
        found.append([name, compared, *told, str(each.found.rows), figures.p_value(each.found.shown_p)])
    return _table(["Task", "Difference", "Points or return", "95 % interval", "Rows", "p"], found, left=2)


def _table(headers: Sequence[str], rows: Iterable[Sequence[str]], left: int) -> Iterable[str]:
    yield f"| {' | '.join(headers)} |"
    yield f"| {' | '.join('---' if place < left else '---:' for place in range(len(headers)))} |"
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _text(value: str) -> str:
    """Return a name in which nothing is markup."""
    return _SPECIAL.sub(r"\\\1", one_line(value, _LONGEST_NAME))
