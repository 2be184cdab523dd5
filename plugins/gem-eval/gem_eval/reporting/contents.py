"""What a report says, before it has a form: who took part, the scores, differences, and episodes to look at."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gem_eval.scores import Metric, Score, compute_scores
from gem_eval.statistics import Estimate, differences, paired_difference, permutation_test

if TYPE_CHECKING:
    from gem_eval.records import Row, Run

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


@dataclass(frozen=True)
class Difference:
    """How much more one entrant scored than another on the rows that both have.

    Args:
        task: The task, or ``"all"``.
        metric: Of which score.
        first: Whose score is taken away.
        second: From whose score.
        estimate: Mean of ``second - first`` over the shared rows.
        rows: Number of shared rows.
        better: Rows on which the second scored more.
        worse: Rows on which it scored less.
        p: Two-sided p-value of a permutation test.
    """

    task: str
    metric: Metric
    first: Entrant
    second: Entrant
    estimate: Estimate
    rows: int
    better: int
    worse: int
    p: float


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
    differences: list[Difference]
    paired_by_task: bool

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

    def tasks_with(self, metric: Metric) -> list[str]:
        """Return the tasks that have a score by a metric."""
        return [task for task in self.tasks if any((task, metric) in each.scores for each in self.entrants)]

    def main_metric(self, task: str) -> Metric:
        """Return ``"success"`` where the task tells of it, else ``"return"``."""
        return "success" if any((task, "success") in each.scores for each in self.entrants) else "return"


def contents_of(runs: Sequence[Run]) -> Contents:
    """Return what a report of some runs says."""
    entrants = _entrants(runs)
    tasks = list(dict.fromkeys(task for entrant in entrants for task in entrant.by_task))
    by_task = len(tasks) <= _MOST_TASKS_PAIRED
    return Contents(list(runs), entrants, tasks, _differences(entrants, tasks if by_task else []), by_task)


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
    by_row: dict[tuple[str, str], list[bool]] = {}
    for row in rows:
        if row.success is not None:
            by_row.setdefault((row.id, row.row), []).append(row.success)
    k = max(map(len, by_row.values()), default=0)
    counts = Counter(sum(verdicts) for verdicts in by_row.values() if len(verdicts) == k)
    return k, [counts[times] for times in range(k + 1)]


def examples(entrants: Sequence[Entrant], limit: int) -> list[tuple[Entrant, Row]]:
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
    by_model: dict[tuple[int, str], list[Row]] = {}
    scores: dict[tuple[int, str], dict[tuple[str, Metric], Score]] = {}
    for number, run in enumerate(runs):
        rows = run.rows
        for row in rows:
            by_model.setdefault((number, row.model), []).append(row)
        for score in compute_scores(rows):
            scores.setdefault((number, score.model), {})[score.id, score.metric] = score
    labels = _labels([(runs[number], model) for number, model in by_model])
    entrants = []
    for place, ((number, model), rows) in enumerate(by_model.items()):
        by_task: dict[str, list[Row]] = {}
        for row in rows:
            by_task.setdefault(row.id, []).append(row)
        entrants.append(
            Entrant(place, labels[place], runs[number], model, rows, by_task, scores.get((number, model), {}))
        )
    return entrants


def _labels(pairs: Sequence[tuple[Run, str]]) -> list[str]:
    """Return a name for each model of a run: the shortest form in which no two are alike."""
    forms: list[Callable[[Run, str], str]] = [
        lambda run, model: model or run.name,
        lambda run, model: run.name,
        lambda run, model: f"{model} · {run.name}",
        lambda run, model: f"{model} · {run.path}",
    ]
    named = ([form(run, model) for run, model in pairs] for form in forms)
    labels = next((labels for labels in named if len(set(labels)) == len(labels)), None)
    return labels or [f"{model} ({place})" for place, (_, model) in enumerate(pairs, start=1)]


def _differences(entrants: Sequence[Entrant], tasks: Sequence[str]) -> list[Difference]:
    pairs = list(itertools.combinations(entrants, 2))
    if len(entrants) > _MOST_PAIRED:
        pairs = [(first, second) for first, second in pairs if first.place == 0]
    asked = ["all", *tasks] if len(tasks) != 1 else list(tasks)
    found = [_difference(task, first, second) for first, second in pairs for task in asked]
    return [each for each in found if each is not None]


def _difference(task: str, first: Entrant, second: Entrant) -> Difference | None:
    """Return the difference of two entrants by success, else by return; None where they share no rows."""
    # Returns of different tasks are of different sizes, and have no mean.
    metrics: tuple[Metric, ...] = ("success",) if task == "all" else ("success", "return")
    for metric in metrics:
        one, other = _values(first, task, metric), _values(second, task, metric)
        shared = [row for row in one if row in other]
        if shared:
            a, b = [other[row] for row in shared], [one[row] for row in shared]
            apart = differences(a, b)
            estimate = paired_difference(a, b, rates=metric == "success")
            better, worse = sum(each > 0 for each in apart), sum(each < 0 for each in apart)
            p = permutation_test(apart)
            return Difference(task, metric, first, second, estimate, len(shared), better, worse, p)
    return None


def _values(entrant: Entrant, task: str, metric: Metric) -> dict[tuple[str, str], list[float]]:
    """Return the values of each row that counts, of the tasks that have a score by this metric."""
    values: dict[tuple[str, str], list[float]] = {}
    for row in entrant.of_task(task):
        value = row.success if metric == "success" else row.episode_return
        if row.error is None and value is not None and math.isfinite(value) and (row.id, metric) in entrant.scores:
            values.setdefault((row.id, row.row), []).append(float(value))
    return values
