"""Tables with a line for each task and model, and the names in them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from gem_eval.reporting import plots
from gem_eval.reporting.markup import Cell, name, name_cell, table

if TYPE_CHECKING:
    from gem_eval.reporting.contents import Contents, Entrant
    from gem_eval.scores import Metric


class Line(NamedTuple):
    """A line of a table.

    Args:
        task: The task, or ``"all"``.
        entrant: The model.
        span: Number of lines of the task, for its first; 0 for the others.
    """

    task: str
    entrant: Entrant
    span: int


def lines(
    contents: Contents, tasks: Sequence[str], metric: Metric | None = None, *, with_all: bool = True
) -> Iterator[Line]:
    """Yield a line for each task and each model that played it, then for all tasks together.

    Args:
        contents: The contents of the report.
        tasks: The tasks.
        metric: Only those that have a score by this metric.
        with_all: Whether several tasks are followed by all together.
    """
    for task in [*tasks, *(["all"] if with_all and len(tasks) > 1 else [])]:
        found = [
            entrant
            for entrant in contents.entrants
            if ((task, metric) in entrant.scores if metric else entrant.of_task(task))
        ]
        for place, entrant in enumerate(found):
            yield Line(task, entrant, 0 if place else len(found))


def lined_table(
    contents: Contents, chosen: Sequence[Line], headers: Sequence[Cell], cells: Callable[[Line], Sequence[Cell]]
) -> str:
    """Return a table with a row for each line.

    Args:
        contents: The contents of the report.
        chosen: The lines.
        headers: Of the columns after the names.
        cells: Returns those of a line after the names.
    """
    several = len(contents.entrants) > 1
    heads = [Cell("Task", "name"), *([Cell(contents.kind, "name")] if several else []), *headers]
    rows = []
    for line in chosen:
        names = [name_cell(task_name(line.task), span=line.span)] if line.span else []
        names += [Cell(series_name(line.entrant), "name")] if several else []
        kind = "again" if not line.span else "all" if line.task == "all" else ""
        rows.append((kind, [*names, *cells(line)]))
    return table(heads, rows)


def legend(contents: Contents) -> str:
    """Return which colour is which model; empty for one."""
    if len(contents.entrants) == 1:
        return ""
    return f'<div class="legend">{"".join(map(series_name, contents.entrants))}</div>'


def series_name(entrant: Entrant) -> str:
    """Return the name of a model with its colour."""
    colour = plots.swatch(f"s{entrant.place % plots.COLOURS}")
    return f'<span class="series">{colour}<span>{name(entrant.label)}</span></span>'


def task_name(task: str) -> str:
    """Return the name of a task, or of all."""
    return "all tasks" if task == "all" else task
