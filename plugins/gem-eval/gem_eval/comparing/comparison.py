"""Compare two models, or two runs of one, row by row."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from gem_core.errors import ArgumentError
from gem_core.records import Range, shared_range
from gem_eval.comparing.cautions import cautions_of
from gem_eval.comparing.sides import Given, RowEpisodes, Side, Task, sides_of
from gem_eval.grouping import grouped
from gem_eval.scores import Metric, tells_success
from gem_eval.statistics import (
    Estimate,
    differences,
    mcnemar,
    more_rows_needed,
    paired_difference,
    permutation_test,
    row_means,
)

if TYPE_CHECKING:
    from gem_eval.records import Row

LEVEL = 0.05
"""A p-value below it is called significant."""

Pairs = Mapping[Task, tuple[RowEpisodes, RowEpisodes]]


@dataclass(frozen=True)
class Difference:
    """What two sides differ by, on one task or on all together.

    Args:
        id: The task; ``"all"`` for several, each of whose rows weighs the same.
        rows: Number of rows that both have a value for.
        a: Mean of the first side on these rows; None without any.
        b: Mean of the second.
        difference: ``b - a`` with its 95 % interval; None without rows.
        p: Two-sided p-value of the test that there is no difference; None without rows.
        p_holm: The same, corrected by Holm for the tasks, or pairs of sides, tested beside it. Tests that cannot reach
            the level, as too few of their rows differ, are left out of the count, after Tarone.
        test: ``"mcnemar"`` for verdicts with one epoch of each row; else ``"permutation"`` of signs by row.
        only_a: Rows that only the first solved; None where values are not verdicts.
        only_b: Rows that only the second solved.
        more_rows: How many more rows would settle a difference of this size with a power of 80 %; 0 where these rows
            do, None where no number would.
        more_episodes: As many rows by the epochs that a row has, for one side.
        least_p: The lowest p-value that the test could give with as many rows that differ.
    """

    id: str
    rows: int
    a: float | None = None
    b: float | None = None
    difference: Estimate | None = None
    p: float | None = None
    p_holm: float | None = None
    test: str = "permutation"
    only_a: int | None = None
    only_b: int | None = None
    more_rows: int | None = None
    more_episodes: int | None = None
    least_p: float | None = None

    @property
    def significant(self) -> bool:
        """Whether the corrected p-value is below the level."""
        return self.p_holm is not None and self.p_holm < LEVEL

    @property
    def shown_p(self) -> float | None:
        """The p-value that tables show: corrected for a task, as it is for all tasks together."""
        return self.p if self.id == "all" else self.p_holm

    @property
    def verdict(self) -> str:
        """``"a"`` or ``"b"``, which is significantly better; or ``"undecided"``."""
        if self.difference is None or not self.significant:
            return "undecided"
        return "b" if self.difference.mean > 0 else "a"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON."""
        record = {**vars(self), "verdict": self.verdict}
        record["difference"] = None if self.difference is None else self.difference._asdict()
        return record


@dataclass(frozen=True)
class Flip:
    """A row that only one side solved; of values that are no verdicts, one with different means.

    Args:
        id: The task.
        row: The row of it.
        a: Mean of the first side.
        b: Mean of the second.
        episode_a: The episode of the first that shows it: with its highest value where it is the better one, else with
            its lowest.
        episode_b: The same of the second.
    """

    id: str
    row: str
    a: float
    b: float
    episode_a: Row = field(repr=False)
    episode_b: Row = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON, the episodes by their numbers."""
        return {**vars(self), "episode_a": self.episode_a.number, "episode_b": self.episode_b.number}


@dataclass(frozen=True)
class Comparison:
    """Two sides compared.

    Args:
        a: The first side.
        b: The second.
        metric: ``"success"`` or ``"return"``.
        scores: Name of the scores of ``gem score`` that are compared instead; None for what environments said.
        tasks: The difference on each task. Their p-values are corrected for the number of tasks.
        overall: The difference on all rows together.
        flips: Rows that only one side solved, those of one kind together; see ``Flip``.
        only_a: Number of rows that only the first side has episodes of; they are left out.
        only_b: The same of the second.
        left_out: Number of rows of both without a value on one side, as all its episodes are errors or unscored.
        errors: Number of episodes with an error, of each side.
        unscored: Number of episodes without a verdict, of each side.
        cut_off: Number of episodes that a limit cut off, of each side. They count as not solved.
        without_cut_off: The difference without them, where that changes the verdict; else None.
        cautions: Why the two sides may not be comparable, in words.
    """

    a: Side
    b: Side
    metric: Metric
    scores: str | None
    tasks: list[Difference]
    overall: Difference
    flips: list[Flip]
    only_a: int
    only_b: int
    left_out: int
    errors: tuple[int, int]
    unscored: tuple[int, int]
    cut_off: tuple[int, int]
    without_cut_off: Difference | None
    cautions: list[str]

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON."""
        record: dict[str, Any] = dict(vars(self))
        for name in ("a", "b"):
            side: Side = record[name]
            record[name] = {"label": side.label, "run": str(side.run.path), "model": side.model}
        record["tasks"] = [each.to_dict() for each in self.tasks]
        record["overall"] = self.overall.to_dict()
        record["flips"] = [each.to_dict() for each in self.flips]
        record["without_cut_off"] = None if self.without_cut_off is None else self.without_cut_off.to_dict()
        return record


def compare(
    a: Given,
    b: Given | None = None,
    *,
    models: Sequence[str] = (),
    metric: Metric | None = None,
    scores: str | None = None,
) -> Comparison:
    """Compare two runs, or two models of one, paired by row.

    Args:
        a: A run: its folder, a file of ``gem run``, or an open ``Run``; ``"RUN@MODEL"`` is one model of it.
        b: Another run; None compares two models of the first.
        models: Take these models of every run.
        metric: ``"success"`` or ``"return"``; None for success where the tasks tell it, else return.
        scores: Compare by the scores that ``gem score`` wrote under this name.

    Raises:
        ArgumentError: There are not two sides to compare, or they share no row.
        EpisodeFileError: A run cannot be read.
    """
    sides = sides_of([a] if b is None else [a, b], models, scores)
    if len(sides) != 2:
        raise ArgumentError(f"compare() takes two, not {len(sides)}: {', '.join(side.label for side in sides)}")
    return compare_sides(sides[0], sides[1], metric or default_metric(sides), scores)


def compare_with_first(sides: Sequence[Side], metric: Metric, scores: str | None = None) -> list[Comparison]:
    """Compare each of several sides with the first; p-values of the overall differences are corrected for all."""
    found = [compare_sides(sides[0], other, metric, scores) for other in sides[1:]]
    overall = _corrected([each.overall for each in found])
    return [replace(each, overall=one) for each, one in zip(found, overall, strict=True)]


def default_metric(sides: Iterable[Side]) -> Metric:
    """Return ``"success"`` where a task of some sides tells whether it was solved, else ``"return"``."""
    return "success" if _telling_tasks(sides) else "return"


def compare_sides(a: Side, b: Side, metric: Metric, scores: str | None = None) -> Comparison:
    """Compare two sides; see ``compare``."""
    told = _telling_tasks([a, b]) if metric == "success" and scores is None else None

    def counts(row: Row) -> bool:
        return told is None or row.id in told

    everything = [side.by_task(metric, counts) for side in (a, b)]
    both = [task for task in everything[0] if task in everything[1]]
    if not both:
        _refuse(a, b, metric, told)
    pairs = _pairs(*everything)
    verdicts = (metric == "success" or scores is not None) and _are_verdicts(pairs)
    tasks, overall = _differences(pairs, verdicts=verdicts, scored=scores is not None)
    shared = set(both)
    rows = [[row for row in side.rows if (row.id, row.row) in shared] for side in (a, b)]
    cut_off = _counts(rows, lambda row: row.cut_off is not None)
    without = overall
    if any(cut_off):
        kept = (side.by_task(metric, lambda row: counts(row) and row.cut_off is None) for side in (a, b))
        without = _differences(_pairs(*kept), verdicts=verdicts, scored=scores is not None)[1]
    return Comparison(
        a,
        b,
        metric,
        scores,
        tasks,
        overall,
        _flips(pairs, verdicts=verdicts),
        only_a=len(everything[0]) - len(both),
        only_b=len(everything[1]) - len(both),
        left_out=len(both) - len(pairs),
        errors=_counts(rows, lambda row: row.error is not None),
        unscored=(
            sum(everything[0][task].unscored for task in both),
            sum(everything[1][task].unscored for task in both),
        ),
        cut_off=cut_off,
        without_cut_off=None if without.verdict == overall.verdict else without,
        cautions=cautions_of(a, b, both),
    )


def paired_differences(a: Side, b: Side, metric: Metric) -> list[Difference]:
    """Return the difference of two sides on each task that both have values for, then, of several, on all of them.

    Args:
        a: The first side.
        b: The second.
        metric: By which tasks are compared; those that do not tell success have no difference in it.
    """
    told = _telling_tasks([a, b]) if metric == "success" else None
    pairs = _pairs(*(side.by_task(metric, lambda row: told is None or row.id in told) for side in (a, b)))
    tasks, overall = _differences(pairs, verdicts=metric == "success" and _are_verdicts(pairs))
    return [*tasks, overall] if len(tasks) > 1 else tasks


def _telling_tasks(sides: Iterable[Side]) -> set[str]:
    by_id = grouped((row for side in sides for row in side.rows), lambda row: row.id)
    return {name for name, rows in by_id.items() if tells_success(rows)}


def _refuse(a: Side, b: Side, metric: Metric, told: set[str] | None) -> None:
    if told is not None and not told:
        raise ArgumentError(f"no task of {a.label} and {b.label} tells whether it was solved; compare --metric return")
    first, second = (side.rows[0].row for side in (a, b))
    raise ArgumentError(
        f"{a.label} and {b.label} share no row to compare by {metric}: the first has {first!r} …, the second "
        f"{second!r} …. Runs share rows where they have the same environments and seed"
    )


def _pairs(a: Mapping[Task, RowEpisodes], b: Mapping[Task, RowEpisodes]) -> dict[Task, tuple[RowEpisodes, RowEpisodes]]:
    """Return the rows that both have a value for."""
    return {task: (one, b[task]) for task, one in a.items() if one.values and task in b and b[task].values}


def _are_verdicts(pairs: Pairs) -> bool:
    return all(value in (0, 1) for pair in pairs.values() for side in pair for value in side.values)


def _differences(pairs: Pairs, *, verdicts: bool, scored: bool = False) -> tuple[list[Difference], Difference]:
    """Return the difference on each task, and on all."""
    by_id = grouped(pairs.items(), lambda item: item[0][0])
    tasks = _corrected([_difference(name, dict(own), verdicts=verdicts, scored=scored) for name, own in by_id.items()])
    return tasks, tasks[0] if len(tasks) == 1 else _difference("all", pairs, verdicts=verdicts, scored=scored)


def _difference(name: str, pairs: Pairs, *, verdicts: bool, scored: bool) -> Difference:
    if not pairs:
        return Difference(name, 0)
    a, b = ([pair[side].values for pair in pairs.values()] for side in (0, 1))
    once = all(len(values) == 1 for values in (*a, *b))
    apart = differences(b, a)
    only_a = sum(_solved_by_one(*pair) for pair in pairs.values()) if verdicts else None
    only_b = sum(_solved_by_one(other, one) for one, other in pairs.values()) if verdicts else None
    if verdicts and once:
        test, p = "mcnemar", mcnemar(only_a or 0, only_b or 0)
    else:
        test, p = "permutation", permutation_test(apart)
    more = more_rows_needed(apart, p)
    epochs = math.fsum(len(values) for values in (*a, *b)) / (2 * len(pairs))
    return Difference(
        name,
        len(pairs),
        float(row_means(a).mean()),
        float(row_means(b).mean()),
        paired_difference(b, a, within=_range_of(pairs, known=verdicts or scored)),
        p,
        p,
        test,
        only_a,
        only_b,
        more,
        None if more is None else math.ceil(more * epochs),
        min(1.0, 2 / 2 ** sum(value != 0 for value in apart)),  # all that differ on one side: 2 of 2**n assignments
    )


def _range_of(pairs: Pairs, *, known: bool) -> Range | None:
    """Return the range that the values of both sides can have; None where it is not known.

    Args:
        pairs: The rows.
        known: Whether values are verdicts or scores of a grader, from 0 to 1, and not returns of environments.
    """
    played = [side for pair in pairs.values() for side in pair]
    values = [value for side in played for value in side.values]
    declared = [(0.0, 1.0)] if known else [row.return_range for side in played for row in side.rows]
    return shared_range(declared, min(values), max(values))


def _solved_by_one(one: RowEpisodes, other: RowEpisodes) -> bool:
    return max(one.values) == 1 and max(other.values) == 0


def _flips(pairs: Pairs, *, verdicts: bool) -> list[Flip]:
    found = []
    for (task, row), (a, b) in pairs.items():
        flipped = _solved_by_one(a, b) or _solved_by_one(b, a) if verdicts else a.mean != b.mean
        if flipped:
            better = a.mean > b.mean
            shown = a.extreme(highest=better), b.extreme(highest=not better)
            found.append(Flip(task, row, a.mean, b.mean, *shown))
    # Those that got worse first, the largest difference first; sorting is stable.
    return sorted(found, key=lambda flip: (flip.b > flip.a, -abs(flip.b - flip.a)))


def _corrected(tested: Sequence[Difference]) -> list[Difference]:
    """Correct the p-values of several tests, so that one false alarm among all is as rare as the level says.

    Source: S. Holm, Scandinavian Journal of Statistics 6 (1979), 65-70; R. E. Tarone, Biometrics 46 (1990), 515-522.
    """
    factor, counted = counted_tests(tested)
    corrected = {place: min(1.0, factor * each.p) for place, each in enumerate(tested) if each.p is not None}
    order = sorted((each.p, place) for place, each in enumerate(tested) if each.p is not None and place in counted)
    highest = 0.0
    for rank, (p, place) in enumerate(order):
        highest = max(highest, min(1.0, (len(order) - rank) * p))
        corrected[place] = highest
    return [replace(each, p_holm=corrected.get(place)) for place, each in enumerate(tested)]


def counted_tests(tested: Sequence[Difference]) -> tuple[int, list[int]]:
    """Return Tarone's factor, and the places of the tests that can reach the level divided by it.

    The factor is the lowest for which no more tests than that can; what the others find is never significant.
    """
    factor, places = 0, list(range(len(tested)))
    while len(places) > factor:
        factor += 1
        least = [each.least_p for each in tested]
        places = [place for place, p in enumerate(least) if p is not None and p * factor < LEVEL]
    return factor, places


def _counts(rows: Sequence[Sequence[Row]], condition: Callable[[Row], bool]) -> tuple[int, int]:
    a, b = (sum(map(condition, side)) for side in rows)
    return a, b
