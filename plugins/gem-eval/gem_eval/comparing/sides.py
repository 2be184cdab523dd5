"""``Side``: one model of one run, with the value of each of its episodes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean
from gem_eval.grouping import grouped
from gem_eval.opening import require_episodes
from gem_eval.records import Row, Run, open_run
from gem_eval.scoring.file import values_of

if TYPE_CHECKING:
    from gem_eval.scores import Metric

Task = tuple[str, str]
"""Id of a task, and the row of it."""


@dataclass
class Side:
    """One model of one run: what is compared.

    Args:
        label: What tables call it; unique among the sides of a comparison.
        run: The run.
        model: Name of the model.
        rows: Its episodes.
        scores: Values of episodes by number, where they are compared by the scores of a grader.
    """

    label: str
    run: Run
    model: str
    rows: list[Row]
    scores: dict[int, float | None] | None = None

    def value(self, row: Row, metric: Metric) -> float | None:
        """Return what an episode counts; None for an error, an unscored episode, and a return that is not finite."""
        if row.error is not None:
            return None
        value: float | None
        if self.scores is not None:
            value = self.scores.get(row.number)
        else:
            value = row.success if metric == "success" else row.episode_return
        return None if value is None or not math.isfinite(value) else float(value)

    def by_task(self, metric: Metric, counts: Callable[[Row], bool] = lambda row: True) -> dict[Task, RowEpisodes]:
        """Return the episodes of each task that the run has, with their values.

        Args:
            metric: What a value is.
            counts: Whether an episode counts at all.
        """
        found: dict[Task, RowEpisodes] = {}
        for row in filter(counts, self.rows):
            played = found.setdefault((row.id, row.row), RowEpisodes())
            if (value := self.value(row, metric)) is not None:
                played.rows.append(row)
                played.values.append(value)
            elif row.error is None:
                played.unscored += 1
        return found


@dataclass
class RowEpisodes:
    """The episodes of one row.

    Args:
        rows: Episodes with a value.
        values: Their values.
        unscored: Number of episodes without a verdict.
    """

    rows: list[Row] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    unscored: int = 0

    @property
    def mean(self) -> float:
        """Mean of the values."""
        return math.fsum(self.values) / len(self.values)

    def extreme(self, *, highest: bool) -> Row:
        """Return the first episode with the highest, or the lowest, value."""
        best = (max if highest else min)(self.values)
        return self.rows[self.values.index(best)]


Given = str | Path | Run | Side
"""A run, or one model of it as ``"RUN@MODEL"``."""


def sides_of(given: Iterable[Given], models: Sequence[str] = (), scores: str | None = None) -> list[Side]:
    """Return what is compared.

    Args:
        given: Runs, each with one model or named as ``RUN@MODEL``. One run alone stands for all its models.
        models: Take these models of every run.
        scores: Name of the scores that ``gem score`` wrote, to compare by; None compares what environments said.

    Raises:
        ArgumentError: A run has no episodes, no such model, or several and none is named.
        EpisodeFileError: A run cannot be read.
    """
    given = list(given)
    found: list[Side] = []
    for each in given:
        if isinstance(each, Side):
            found.append(each)
            continue
        run, model = _run_and_model(each)
        require_episodes(run)
        sides = {side.model: side for side in models_of(run, scores)}
        names = list(sides)
        chosen = [model] if model is not None else list(models) or names
        if len(chosen) > 1 and not models and len(given) > 1:
            choices = " or ".join(f"{run.path}@{name}" for name in names[:3])
            raise ArgumentError(f"{run.path} has {len(names)} models: name one, as {choices}, or give --model")
        for name in chosen:
            if name not in names:
                hint = did_you_mean(name, names)
                raise ArgumentError(f"{run.path} has no model {name!r}.{hint} It has {', '.join(names)}")
            found.append(sides[name])
    if len(found) < 2:
        raise ArgumentError("a comparison takes two runs or more, or one run of several models")
    return labelled(found)


def models_of(run: Run, scores: str | None = None) -> list[Side]:
    """Return each model of a run, in order of appearance and without a label; see ``sides_of``."""
    values = None if scores is None else values_of(run, scores)
    return [Side("", run, model, own, values) for model, own in grouped(run.rows, lambda row: row.model).items()]


def _run_and_model(given: str | Path | Run) -> tuple[Run, str | None]:
    if isinstance(given, Run):
        return given, None
    path = str(given)
    at = path.find("@")
    while not Path(path).exists() and at != -1:
        if Path(path[:at]).exists():
            return open_run(path[:at]), path[at + 1 :]
        at = path.find("@", at + 1)
    return open_run(path), None


def labelled(sides: Sequence[Side]) -> list[Side]:
    """Return the sides with labels: the model where all are of one run, the run where all have one model, or both.

    Raises:
        ArgumentError: A model of a run is there twice.
    """
    runs, models = {side.run.path for side in sides}, {side.model for side in sides}
    if len(runs) == 1:
        labels = [side.model or side.run.name for side in sides]
    elif len(models) == 1:
        labels = [side.run.name for side in sides]
    else:
        labels = [f"{side.run.name}@{side.model}" for side in sides]
    if len(set(labels)) < len(sides):
        labels = [f"{side.run.path}@{side.model}" for side in sides]
    if len(set(labels)) < len(sides):
        raise ArgumentError(f"{next(each for each in labels if labels.count(each) > 1)} is given twice")
    return [replace(side, label=label) for side, label in zip(sides, labels, strict=True)]
