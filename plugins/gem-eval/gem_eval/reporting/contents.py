"""What a report says, before it has a form: who took part, the scores, differences, and episodes to look at."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from gem_core.cli import counted
from gem_eval import figures
from gem_eval.comparing.comparison import paired_differences
from gem_eval.comparing.sides import Side, labelled, models_of
from gem_eval.grouping import grouped
from gem_eval.scores import Metric, Score, compute_scores

if TYPE_CHECKING:
    from gem_eval.comparing.comparison import Difference
    from gem_eval.records import Row, Run
    from gem_eval.statistics import Estimate

_MOST_PAIRED = 3
"""Of more entrants than this, each is compared with the first only."""

_MOST_TASKS_PAIRED = 12
"""Of more tasks than this, only all together are compared."""


@dataclass(frozen=True)
class Entrant:
    """A model of a run.

    Args:
        place: From 0; its colour in plots.
        label: Its name, which no other entrant has.
        run: The run.
        model: The model.
        rows: Its episodes.
        by_task: Its episodes of each task.
        scores: Its scores, by task (``"all"`` for several together) and metric.
    """

    place: int
    label: str
    run: Run
    model: str
    rows: list[Row]
    by_task: dict[str, list[Row]]
    scores: dict[tuple[str, Metric], Score]

    def of_task(self, task: str) -> list[Row]:
        """Return the episodes of a task, or of ``"all"``."""
        return self.rows if task == "all" else self.by_task.get(task, [])


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

    @property
    def rows(self) -> list[Row]:
        """Its episodes."""
        return self.entrant.of_task(self.task)

    def score(self, metric: Metric) -> Score:
        """Return its score."""
        return self.entrant.scores[self.task, metric]


class Paired(NamedTuple):
    """How much more one entrant scored than another on the rows that both have.

    Args:
        first: Whose score is taken away.
        second: From whose score.
        metric: Of which score.
        found: The difference on one task, or on all of them.
        estimate: Its mean and interval.
    """

    first: Entrant
    second: Entrant
    metric: Metric
    found: Difference
    estimate: Estimate


@dataclass(frozen=True)
class Contents:
    """What a report says.

    Args:
        runs: The runs.
        entrants: The models of the runs, in order of appearance.
        tasks: Names of the tasks, in order of appearance.
        differences: Paired differences; none where no two entrants share rows.
        paired_by_task: Whether ``differences`` are of each task as well.
    """

    runs: list[Run]
    entrants: list[Entrant]
    tasks: list[str]
    differences: list[Paired]
    paired_by_task: bool

    @property
    def title(self) -> str:
        """Names of the runs."""
        return " and ".join(run.name for run in self.runs)

    @property
    def kind(self) -> str:
        """What entrants are: models, or runs of one model."""
        return "Run" if len(self.runs) > 1 and len({each.model for each in self.entrants}) == 1 else "Model"

    @property
    def rows(self) -> list[Row]:
        """All episodes."""
        return [row for entrant in self.entrants for row in entrant.rows]

    @property
    def epochs(self) -> int:
        """Most epochs that a row was played."""
        return max((row.epoch + 1 for row in self.rows), default=0)

    def lines(self, tasks: Sequence[str], metric: Metric | None = None, *, with_all: bool = True) -> list[Line]:
        """Return a line for each task and each model that played it, then for all tasks together.

        Args:
            tasks: The tasks.
            metric: Only models with a score by this metric.
            with_all: Whether several tasks are followed by all together.
        """
        found = []
        for task in [*tasks, *(["all"] if with_all and len(tasks) > 1 else [])]:
            own = [each for each in self.entrants if ((task, metric) in each.scores if metric else each.of_task(task))]
            found += [Line(task, entrant, 0 if place else len(own)) for place, entrant in enumerate(own)]
        return found

    def tasks_with(self, metric: Metric) -> list[str]:
        """Return the tasks that have a score by a metric."""
        return [task for task in self.tasks if any((task, metric) in each.scores for each in self.entrants)]

    def return_tasks(self) -> list[str]:
        """Return the tasks whose returns say more than their successes: they are not 1 for success and else 0."""
        return [
            task
            for task in self.tasks_with("return")
            if any(row.success is None or row.episode_return != row.success for row in self.counted(task))
        ]

    def counted(self, task: str) -> list[Row]:
        """Return the episodes of a task without an error."""
        return [row for entrant in self.entrants for row in entrant.of_task(task) if row.error is None]

    def main_score(self, entrant: Entrant) -> Score | None:
        """Return the score that says most of an entrant: of all tasks if there are several, of success if told."""
        tasks = list(entrant.by_task)
        told = self.tasks_with("success")
        tasks = [task for task in tasks if task in told] or tasks
        if not told and len(tasks) > 1:
            return None  # returns of different tasks are of different sizes
        return entrant.scores.get((tasks[0] if len(tasks) == 1 else "all", "success" if told else "return"))

    def summary(self) -> str:
        """Return in a sentence how much was played."""
        rows = self.rows
        if not rows:
            return "No episodes."
        different = len({(row.id, row.row) for row in rows})
        errors = sum(row.error is not None for row in rows)
        models = {each.model for each in self.entrants}
        told = f"{counted(len(models), 'model')} on {counted(len(self.tasks), 'task')}: "
        if len(self.runs) > 1:
            told = f"{counted(len(self.runs), 'run')}, {told}"
        told += f"{counted(len(rows), 'episode')} of {counted(different, 'row')}"
        told += f", {counted(errors, 'error')}." if errors else "."
        unfinished = [run.name for run in self.runs if run.info.get("status", "finished") != "finished"]
        told += f" Not finished: {' and '.join(unfinished)}." if unfinished else ""
        ended = [row.finished for row in rows if row.finished is not None]
        return f"{told} Last episode: {figures.moment(max(ended))}." if ended else told


def contents_of(runs: Sequence[Run]) -> Contents:
    """Return what a report of some runs says."""
    entrants = _entrants(runs)
    tasks = list(dict.fromkeys(task for entrant in entrants for task in entrant.by_task))
    by_task = len(tasks) <= _MOST_TASKS_PAIRED
    return Contents(list(runs), entrants, tasks, _differences(entrants, by_task=by_task), by_task)


def ending_of(row: Row) -> str:
    """Return how an episode ended, in words, one of: error, success, cut off by …, unscored, failure."""
    if row.error is not None:
        return "error"
    if row.success:
        return "success"
    if row.cut_off is not None:
        return f"cut off by {row.cut_off}"
    return "unscored" if row.success is None else "failure"


def endings(rows: Sequence[Row]) -> list[str]:
    """Return the endings that episodes had, in the order in which they are shown."""
    order = ("success", "failure", "unscored", "cut off by turns", "cut off by tokens")
    found = Counter(map(ending_of, rows))
    first = [each for each in order if each in found]
    between = sorted(each for each in found if each not in order and each != "error")
    return [*first, *between, *(["error"] if "error" in found else [])]


def solved_counts(rows: Sequence[Row]) -> tuple[int, list[int]]:
    """Return k, the most epochs of a row, and of the rows with so many how many were solved 0, 1, … k times."""
    told = [row for row in rows if row.success is not None]
    by_row = grouped(told, lambda row: (row.id, row.row)).values()
    k = max(map(len, by_row), default=0)
    counts = Counter(sum(bool(row.success) for row in own) for own in by_row if len(own) == k)
    return k, [counts[times] for times in range(k + 1)]


def choose_examples(entrants: Sequence[Entrant], limit: int) -> list[tuple[Entrant, Row]]:
    """Choose episodes to look at: of each ending but success in turn, from as many tasks and models as can be."""
    queues: dict[str, list[tuple[int, Entrant, Row]]] = {}
    seen: Counter[tuple[str, str, str, str | None]] = Counter()
    for entrant in entrants:
        for row in entrant.rows:
            ending = ending_of(row)
            if ending in ("success", "unscored"):
                continue
            ending = "unreadable" if ending == "failure" and row.unreadable else ending
            kind = (ending, row.id, entrant.label, row.cause)
            seen[kind] += 1
            queues.setdefault(ending, []).append((seen[kind], entrant, row))
    for queue in queues.values():
        queue.sort(key=lambda each: (each[0], each[2].number))
    # Errors first: they are what a reader can mend.
    order = sorted(queues, key=lambda ending: (ending != "error", ending))
    taken = [each for turn in itertools.zip_longest(*(queues[ending] for ending in order)) for each in turn if each]
    return [(entrant, row) for _, entrant, row in taken[:limit]]


def _entrants(runs: Sequence[Run]) -> list[Entrant]:
    scores = {run.path: compute_scores(run.rows) for run in runs}
    entrants = []
    for place, side in enumerate(labelled([side for run in runs for side in models_of(run)])):
        own = {(score.id, score.metric): score for score in scores[side.run.path] if score.model == side.model}
        by_task = grouped(side.rows, lambda row: row.id)
        entrants.append(Entrant(place, side.label, side.run, side.model, side.rows, by_task, own))
    return entrants


def _differences(entrants: Sequence[Entrant], *, by_task: bool) -> list[Paired]:
    """Return the differences by success, of all tasks first, and those by return of tasks that do not tell success."""
    pairs = list(itertools.combinations(entrants, 2))
    if len(entrants) > _MOST_PAIRED:
        pairs = [(first, second) for first, second in pairs if first.place == 0]
    found: list[Paired] = []
    for first, second in pairs:
        solved = paired_differences(_side(first), _side(second), "success")
        told = {each.id for each in solved}
        returns = paired_differences(_side(first, told), _side(second, told), "return")
        # Returns of different tasks are of different sizes, and have no mean.
        chosen: list[tuple[Metric, Difference]] = [
            ("success", each) for each in sorted(solved, key=lambda each: each.id != "all")
        ]
        chosen += [("return", each) for each in returns if each.id != "all"]
        for metric, each in chosen:
            if each.difference is not None and (by_task or each.id == "all"):
                found.append(Paired(first, second, metric, each, each.difference))
    return found


def _side(entrant: Entrant, without: Collection[str] = ()) -> Side:
    rows = [row for row in entrant.rows if row.id not in without]
    return Side(entrant.label, entrant.run, entrant.model, rows)
