"""The sections of plots: how episodes ended, epochs, returns and turns, tokens and cost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gem_eval import figures
from gem_eval.reporting import amounts, plots
from gem_eval.reporting.contents import Contents, ending_of, endings, solved_counts
from gem_eval.reporting.lines import Line, legend, lined_table, lines, task_name
from gem_eval.reporting.markup import Cell, figure, section, text
from gem_eval.reporting.score_tables import pass_table

if TYPE_CHECKING:
    from gem_eval.records import Row
    from gem_eval.reporting.contents import Entrant
    from gem_eval.scores import Metric

_MOST_FIGURES = 12
"""Of more tasks than this, plots are of all together."""

_MOST_LISTED = 30
"""Of more tasks than this, only scores are of each."""

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

_SPENT = {"tokens_in": "Tokens read", "tokens_out": "Tokens written", "cost": "Cost", "seconds": "Time"}


def outcomes(contents: Contents) -> str:
    """Return how episodes ended, as stacked bars."""
    kinds = endings(contents.rows)
    classes = [_ENDING_CLASSES.get(kind, "e-limit") for kind in kinds]

    def cells(line: Line) -> list[Cell]:
        found = Counter(map(ending_of, line.entrant.of_task(line.task)))
        told = ", ".join(f"{kind}: {found[kind]}" for kind in kinds)
        bar = plots.stacked([(name, found[kind]) for kind, name in zip(kinds, classes, strict=True)], told)
        return [Cell(bar, "wide"), Cell(str(found.total())), *(Cell(str(found[kind])) for kind in kinds)]

    entries = zip(kinds, classes, strict=True)
    colours = "".join(f"<span>{plots.swatch(name)}{text(kind)}</span>" for kind, name in entries)
    headers = [Cell("Share of episodes", "wide"), Cell("Episodes"), *(Cell(text(kind)) for kind in kinds)]
    shown = lined_table(contents, _listed(contents), headers, cells)
    return section("outcomes", "How episodes ended", f'<div class="legend">{colours}</div>', shown)


def epochs(contents: Contents) -> str:
    """Return how often the same row was solved, and pass@k; empty without epochs."""
    tasks = contents.tasks_with("success") if contents.epochs > 1 else []
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
            title = f"{task_name(task)}: share of rows by how often they were solved"
            found.append(figure(task_name(task), plots.columns(heights, ticks, f"times solved, of {most}", title)))
    if not found:
        return ""
    note = "Shares of the rows that were solved never, once, … and every time."
    shown = [f'<p class="soft">{note}</p>', legend(contents), _grid(found), pass_table(contents, tasks)]
    return section("epochs", "The same row several times", *shown)


def distributions(contents: Contents) -> str:
    """Return histograms of returns and turns; returns of two values and turns of one are left out."""
    found = []
    for task in _figure_tasks(contents.tasks):
        rows = {each.place: _rows(each, task, contents.tasks) for each in contents.entrants}
        counted = {place: [row for row in own if row.error is None] for place, own in rows.items()}
        returns = [(place, [row.episode_return for row in own]) for place, own in counted.items() if own]
        turns = [(place, [float(row.turns) for row in own]) for place, own in counted.items() if own]
        for values, name, least in ((returns, "return", 3), (turns, "turns", 2)):
            if len({value for _, own in values for value in own}) >= least:
                title = f"{task_name(task)}: {name}"
                found.append(figure(title, plots.histogram(values, name, title)))
    if not found:
        return ""
    note = '<p class="soft">Shares of the episodes without an error.</p>'
    return section("distributions", "Returns and turns", note, legend(contents), _grid(found))


def costs(contents: Contents) -> str:
    """Return tokens, cost and time of episodes, alone and against the score; empty where none is known."""
    known = [name for name in _SPENT if any(getattr(row, name) is not None for row in contents.rows)]
    if not known:
        return ""

    def cells(line: Line) -> list[Cell]:
        rows = line.entrant.of_task(line.task)
        told = [_amount(name, amounts.mean_of(rows, name)) for name in ("turns", *known)]
        if "cost" in known:
            total, solved = sum(row.cost or 0 for row in rows), sum(bool(row.success) for row in rows)
            told += [amounts.dollars(total), amounts.dollars(total / solved) if solved else figures.NONE]
        return [Cell(each) for each in told]

    headers = [Cell("Turns"), *(Cell(_SPENT[name]) for name in known)]
    headers += [Cell("Cost in all"), Cell("Cost of a solved one")] if "cost" in known else []
    shown = lined_table(contents, _listed(contents), headers, cells)
    note = '<p class="soft">Means of an episode, errors included: they were paid for as well.</p>'
    clouds = [_cloud(contents, "tokens", "mean tokens of an episode"), _cloud(contents, "cost", "mean cost, $")]
    clouds = [each for each in clouds if each]
    return section(
        "costs", "Tokens, cost and time", *([legend(contents), _grid(clouds)] if clouds else []), note, shown
    )


def _cloud(contents: Contents, name: str, label: str) -> str:
    """Return a plot of scores against an amount; empty with fewer than two points."""
    told = contents.tasks_with("success")
    metric: Metric = "success" if told else "return"
    tasks = told or contents.tasks
    if metric == "return" and len(tasks) > 1:
        return ""  # their returns are of different sizes
    points = []
    for line in lines(contents, tasks, metric):
        score = line.entrant.scores[line.task, metric]
        amount = _spent(line.entrant.of_task(line.task), name)
        if score.mean is None or not amount:
            continue
        low, high = (score.mean if each is None else each for each in (score.low, score.high))
        title = f"{line.entrant.label}, {task_name(line.task)}: {figures.score(score.mean, metric)}"
        whole = line.task == "all" or len(tasks) == 1
        points.append(plots.Point(line.entrant.place, amount, score.mean, low, high, title, whole))
    if len(points) < 2:
        return ""
    scale = plots.SHARES if metric == "success" else plots.Scale.of([end for p in points for end in (p.low, p.high)])
    title = f"{'Success' if metric == 'success' else 'Return'} and {name}"
    return figure(title, plots.scatter(points, label, scale, title))


def _spent(rows: Sequence[Row], name: str) -> float | None:
    """Return the mean cost, or the mean number of tokens, read and written, of episodes."""
    if name == "cost":
        return amounts.mean_of(rows, "cost")
    both = [amounts.mean_of(rows, "tokens_in"), amounts.mean_of(rows, "tokens_out")]
    known = [each for each in both if each is not None]
    return sum(known) if known else None


def _listed(contents: Contents) -> list[Line]:
    found = list(lines(contents, contents.tasks))
    return found if len(contents.tasks) <= _MOST_LISTED else [line for line in found if line.task == "all"]


def _figure_tasks(tasks: Sequence[str]) -> Sequence[str]:
    return tasks if len(tasks) <= _MOST_FIGURES else ["all"]


def _rows(entrant: Entrant, task: str, tasks: Sequence[str]) -> list[Row]:
    """Return the episodes of a task, or of all those named."""
    chosen = set(tasks)
    return [row for row in entrant.of_task(task) if row.id in chosen]


def _grid(found: Sequence[str]) -> str:
    return f'<div class="figures-grid">{"".join(found)}</div>'


def _amount(name: str, value: float | None) -> str:
    if value is None:
        return figures.NONE
    return {"cost": amounts.dollars, "seconds": amounts.duration}.get(name, amounts.number)(value)
