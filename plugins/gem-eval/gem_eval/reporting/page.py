"""A report as one page without script and network: ``assets/report.html``."""

from __future__ import annotations

import itertools
import json
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import TYPE_CHECKING, Any

from gem_core.cli import counted, shown
from gem_core.errors import EpisodeFileError
from gem_eval import figures
from gem_eval.assets import read_assets, render
from gem_eval.reporting import plots
from gem_eval.reporting.contents import Contents, Entrant, Line, choose_examples, ending_of, endings, solved_counts
from gem_eval.turns import error_text, figures_of, parts_of, text_of, turn_views

if TYPE_CHECKING:
    from gem_eval.records import Row, Run
    from gem_eval.scores import Metric, Score

_MOST_CARDS = 8
_MOST_FIGURES = 12
"""Of more tasks than this, plots are of all together."""
_MOST_LISTED = 30
"""Of more tasks than this, only scores are of each."""
_FIRST_TURNS, _LAST_TURNS = 2, 3

_COUNTS = {"truncated": "Cut off", "unreadable": "Unreadable", "unscored": "Unscored", "errors": "Errors"}
_SPENT = {"tokens_in": "Tokens read", "tokens_out": "Tokens written", "cost": "Cost", "seconds": "Time"}
_ENDING_CLASSES = {
    "success": "e-success",
    "failure": "e-failure",
    "unscored": "e-unscored",
    "cut off by turns": "e-turns",
    "cut off by tokens": "e-tokens",
    "cut off by time": "e-time",
    "cut off by token budget": "e-budget",
    "cut off by cost": "e-cost",
    "error": "e-error",
}
_FACTS = ("command", "suite", "models", "tasks", "epochs", "seed", "limits", "sessions", "versions", "host")
"""What of ``run.json`` is told first."""
_NOT_FACTS = ("schema_version", "status")


def html_report(contents: Contents, examples: int) -> str:
    """Return a report as HTML.

    Args:
        contents: What it says.
        examples: How many episodes to show turn by turn, at most.
    """
    success = contents.tasks_with("success")
    lines = contents.lines(contents.tasks)
    cards = [(each, score) for each in contents.entrants if (score := contents.main_score(each)) is not None]
    told = {
        name: title for name, title in _SPENT.items() if any(getattr(row, name) is not None for row in contents.rows)
    }
    scored = contents.lines(success, "success")
    ks = sorted({int(k) for line in scored for k in line.score("success").pass_at if int(k) > 1})
    chosen = choose_examples(contents.entrants, examples)
    return render(
        "report.html",
        contents=contents,
        style=read_assets("report.css"),
        cards=cards[:_MOST_CARDS],
        debatable=[
            line._replace(span=1)
            for line in scored
            if (line.task == "all" or len(success) == 1)
            and set(_otherwise(line.score("success"))[1:]) != {figures.NONE}
        ],
        differences=_differences(contents),
        endings=endings(contents.rows),
        listed=lines if len(contents.tasks) <= _MOST_LISTED else [line for line in lines if line.task == "all"],
        epochs=_epochs(contents, success) if contents.epochs > 1 else [],
        ks=ks,
        pass_titles=["Mean", *(f"pass@{k}" for k in ks), *(f"pass^{k}" for k in ks)],
        distributions=_distributions(contents),
        spent=told,
        clouds=list(filter(None, (_cloud(contents, name) for name in ("tokens", "cost")))),
        examples=[_example(*each, several=len({one.run.path for one, _ in chosen}) > 1) for each in chosen],
        failed=_failed(contents.runs),
        asked=list(filter(None, map(_asked, contents.runs))),
        shares=plots.SHARES,
        figures=figures,
        counted=counted,
        shown=shown,
        quote=lambda path: shlex.quote(str(path)),
        task_name=_task_name,
        count_columns=_count_columns,
        return_scale=_return_scale,
        otherwise=_otherwise,
        pass_row=_pass_row,
        ending_class=lambda ending: _ENDING_CLASSES.get(ending, "e-limit"),
        ending_bar=_ending_bar,
        amounts=_amounts,
    )


def _task_name(task: str) -> str:
    return "all tasks" if task == "all" else task


# Scores


def _count_columns(lines: Sequence[Line], metric: Metric) -> dict[str, str]:
    """Return which counts a table of scores has: those that are not 0 everywhere, and errors."""
    return {
        name: title
        for name, title in _COUNTS.items()
        if name == "errors" or any(getattr(line.score(metric), name) for line in lines)
    }


def _return_scale(contents: Contents, task: str) -> plots.Scale:
    found = [entrant.scores.get((task, "return")) for entrant in contents.entrants]
    ends = [end for each in found if each is not None for end in (each.mean, each.low, each.high) if end is not None]
    return plots.Scale.of(ends)


def _otherwise(score: Score) -> list[str]:
    """Return a score, and what it would be if episodes whose count is debatable counted otherwise."""
    without = [None if each is None else each.mean for each in (score.without_truncated, score.without_unreadable)]
    return [figures.score(each, "success") for each in (score.mean, *without, score.with_errors, score.with_unscored)]


def _pass_row(score: Score, ks: Sequence[int]) -> list[str]:
    found = [each.get(str(k)) for each in (score.pass_at, score.pass_hat) for k in ks]
    means = [score.mean, *(each.mean if each else None for each in found)]
    return [figures.score(each, "success") for each in means]


def _differences(contents: Contents) -> list[tuple[Metric, plots.Scale, list[tuple[str, list[Any]]]]]:
    """Return for each metric a scale, and the differences of each pair of models."""
    tables = []
    for metric in dict.fromkeys(each.metric for each in contents.differences):
        found = [each for each in contents.differences if each.metric == metric]
        ends = [end for each in found for end in (each.estimate.mean, each.estimate.low, each.estimate.high)]
        scale = plots.Scale.of([0.0, *(end for end in ends if end is not None)], percent=metric == "success")
        pairs = itertools.groupby(found, lambda each: f"{each.second.label} minus {each.first.label}")
        tables.append((metric, scale, [(compared, list(group)) for compared, group in pairs]))
    return tables


# Outcomes, distributions and costs


def _ending_bar(line: Line, kinds: Sequence[str]) -> dict[str, Any]:
    """Return the bar of how episodes ended: pieces with class, place and width in thousandths, and the counts."""
    found = Counter(map(ending_of, line.rows))
    pieces, left = [], 0.0
    for kind in kinds:
        width = 1000 * found[kind] / (found.total() or 1)
        pieces.append((_ENDING_CLASSES.get(kind, "e-limit"), f"{left:.2f}", f"{width:.2f}"))
        left += width
    title = ", ".join(f"{kind}: {found[kind]}" for kind in kinds)
    return {"pieces": pieces, "title": title, "total": found.total(), "counts": [found[kind] for kind in kinds]}


def _figure_tasks(tasks: Sequence[str]) -> Sequence[str]:
    return tasks if len(tasks) <= _MOST_FIGURES else ["all"]


def _rows(entrant: Entrant, task: str, tasks: Sequence[str]) -> list[Row]:
    """Return the episodes of a task, or of all those named."""
    chosen = set(tasks)
    return [row for row in entrant.of_task(task) if row.id in chosen]


def _epochs(contents: Contents, tasks: Sequence[str]) -> list[plots.Figure]:
    """Return how often the same row was solved."""
    found = []
    for task in _figure_tasks(tasks):
        heights, most = [], 0
        for entrant in contents.entrants:
            k, counts = solved_counts(_rows(entrant, task, tasks))
            most = max(k, most)
            if total := sum(counts):
                heights.append((entrant.place, [each / total for each in counts]))
        if most > 1:
            ticks = [(place + 0.5, str(place)) for place in range(most + 1)]
            name = _task_name(task)
            title = f"{name}: share of rows by how often they were solved"
            found.append(plots.columns(heights, ticks, f"times solved, of {most}", title, name))
    return found


def _distributions(contents: Contents) -> list[plots.Figure]:
    """Return histograms of returns and turns; returns of two values and turns of one are left out."""
    found = []
    for task in _figure_tasks(contents.tasks):
        rows = {each.place: _rows(each, task, contents.tasks) for each in contents.entrants}
        counts = {place: kept for place, own in rows.items() if (kept := [row for row in own if row.error is None])}
        returns = [(place, [row.episode_return for row in own]) for place, own in counts.items()]
        turns = [(place, [float(row.turns) for row in own]) for place, own in counts.items()]
        for values, name, least in ((returns, "return", 3), (turns, "turns", 2)):
            if len({value for _, own in values for value in own}) >= least:
                found.append(plots.histogram(values, name, f"{_task_name(task)}: {name}"))
    return found


def _amounts(line: Line, told: Mapping[str, str]) -> list[str]:
    """Return the mean turns of a line, what else an episode spent, and the cost of all."""
    amounts = [figures.amount(name, _mean_of(line.rows, name)) for name in ("turns", *told)]
    if "cost" in told:
        total, solved = sum(row.cost or 0 for row in line.rows), sum(bool(row.success) for row in line.rows)
        amounts += [figures.amount("cost", each) for each in (total, total / solved if solved else None)]
    return amounts


def _cloud(contents: Contents, name: str) -> plots.Figure | None:
    """Return a plot of scores against mean tokens, read and written, or cost; None with fewer than two points."""
    told = contents.tasks_with("success")
    metric: Metric = "success" if told else "return"
    tasks = told or contents.tasks
    if metric == "return" and len(tasks) > 1:
        return None  # their returns are of different sizes
    points = []
    for line in contents.lines(tasks, metric):
        score = line.score(metric)
        spent = [_mean_of(line.rows, each) for each in (("cost",) if name == "cost" else ("tokens_in", "tokens_out"))]
        amount = sum(each for each in spent if each is not None)
        if score.mean is None or not amount:
            continue
        low, high = (score.mean if each is None else each for each in (score.low, score.high))
        title = f"{line.entrant.label}, {_task_name(line.task)}: {figures.score(score.mean, metric)}"
        whole = line.task == "all" or len(tasks) == 1
        points.append(plots.Point(line.entrant.place, amount, score.mean, low, high, title, whole))
    if len(points) < 2:
        return None
    scale = plots.SHARES if metric == "success" else plots.Scale.of([end for p in points for end in (p.low, p.high)])
    label = "mean cost, $" if name == "cost" else "mean tokens of an episode"
    return plots.scatter(points, label, scale, f"{'Success' if metric == 'success' else 'Return'} and {name}")


def _mean_of(rows: Sequence[Row], name: str) -> float | None:
    """Return the mean of a field over the episodes that have it."""
    values = [value for row in rows if (value := getattr(row, name)) is not None]
    return fmean(values) if values else None


# Episodes, and what was asked


def _example(entrant: Entrant, row: Row, *, several: bool) -> dict[str, Any]:
    """Return an episode to look at: its first and last turns."""
    ending = "unreadable" if ending_of(row) == "failure" and row.unreadable else ending_of(row)
    told = {"row": row, "run": entrant.run, "several": several, "ending": ending, "problem": ""}
    try:
        episode = entrant.run.episode(row)
        views = list(turn_views(episode))
    except EpisodeFileError as error:
        return {**told, "problem": str(error)}
    first, last = views[:_FIRST_TURNS], views[_FIRST_TURNS:][-_LAST_TURNS:]
    return {
        **told,
        "figures": figures_of(episode),
        "path": shlex.quote(str(entrant.run.path)),
        "first": first,
        "last": last,
        "hidden": len(views) - len(first) - len(last),
        "observation": text_of(parts_of(episode.observation)),
        "error": error_text(episode.error),
    }


def _failed(runs: Sequence[Run]) -> list[tuple[Run, str, list[int]]]:
    """Return the numbers of the episodes that failed, by how they ended."""
    return [
        (run, ending, [row.number for row in run.rows if ending_of(row) == ending])
        for run in runs
        for ending in endings(run.rows)
        if ending not in ("success", "unscored")
    ]


def _asked(run: Run) -> tuple[Run, list[tuple[str, str]], str] | None:
    """Return what ``run.json`` says: in words, and to the letter; None if it says nothing."""
    info = run.info
    facts = {name: info[name] for name in (*_FACTS, *info) if name in info and name not in _NOT_FACTS}
    if isinstance(versions := facts.get("versions"), Mapping):
        own = {name: version for name, version in versions.items() if name == "python" or name.startswith("gem-")}
        facts["versions"] = own or versions
    told = [(name, words) for name, value in facts.items() if (words := _words(value))]
    return (run, told, json.dumps(info, indent=1, ensure_ascii=False)) if told else None


def _words(value: Any) -> str:
    """Return plain JSON in words: what is empty is left out, and times are dates."""
    if value is None or value in ({}, [], ""):
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float) and 1e9 < value < 1e10:
        return figures.moment(value)
    if isinstance(value, list):
        return "; ".join(filter(None, map(_words, value)))
    if not isinstance(value, Mapping):
        return str(value)
    told = [(name, part, words) for name, part in value.items() if (words := _words(part))]
    return ", ".join(
        f"{name} ({words})" if isinstance(part, Mapping) else f"{name} {words}" for name, part, words in told
    )
