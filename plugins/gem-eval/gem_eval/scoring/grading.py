"""``score``: grade the episodes of a run again, and tell what changed."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from gem_core import Episode
from gem_core.background import run_sync
from gem_core.errors import ArgumentError, EpisodeFileError
from gem_core.rollouts import close_agent, prepare_agent
from gem_eval.grouping import grouped
from gem_eval.opening import opened, refuse_seats, require_episodes
from gem_eval.records import Row, Run
from gem_eval.scoring.file import Grade, ScoreFile
from gem_eval.scoring.graders import GradeFunction, Grader, find_grader
from gem_eval.statistics import Agreement, Estimate, agreement, mean, rate

DEFAULT_CONCURRENCY = 64
_AT_ONCE = 256
"""Episodes of a plain grader that are read before the first of them is graded."""

Asked = tuple[Row, int]
"""An episode, and which time it is graded."""


class Changed(NamedTuple):
    """An episode whose verdict is another than the one of the run.

    Args:
        row: The episode.
        old: Whether it was solved.
        new: Whether it is now.
    """

    row: Row
    old: bool
    new: bool


@dataclass(frozen=True)
class TaskScore:
    """Old and new score of one model on one task.

    Args:
        id: The task.
        model: The model.
        episodes: Number of episodes with a new score.
        old: Success rate of these episodes in the run; None where it did not tell.
        new: Their new score, the mean of the repeats of each.
        changed: Number of verdicts that changed.
        unknown: Number of episodes that the grader could not tell.
        errors: Number of episodes that it failed for.
    """

    id: str
    model: str
    episodes: int
    old: Estimate | None
    new: Estimate | None
    changed: int
    unknown: int
    errors: int


@dataclass(frozen=True)
class Rescored:
    """The scores of a run by a grader.

    Args:
        run: The run.
        name: Name of the scores, for ``gem compare --scores``.
        path: Their file.
        graded: What the grader said, by the number of the episode and the repeat.
        tasks: Scores of each model on each task.
        changed: Episodes whose verdict changed.
        agreement: Of the repeats; None without any.
        not_graded: Number of episodes that ended in an error, which are not graded.
    """

    run: Run
    name: str
    path: Path
    graded: Mapping[tuple[int, int], Grade]
    tasks: list[TaskScore]
    changed: list[Changed]
    agreement: Agreement | None
    not_graded: int

    @property
    def errors(self) -> list[Grade]:
        """Where the grader failed."""
        return [each for each in self.graded.values() if each.error is not None]

    @property
    def notes(self) -> list[Grade]:
        """Where it said something besides."""
        return [each for each in self.graded.values() if each.note is not None]


def score(
    run: str | Path | Run,
    grader: str | GradeFunction,
    *,
    repeat: int = 1,
    name: str | None = None,
    rubric: str | None = None,
    kwargs: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
    max_concurrency: int | None = None,
    overwrite: bool = False,
    on_graded: Callable[[int, int], None] | None = None,
) -> Rescored:
    """Grade the episodes of a run again; the record itself is never changed.

    The scores are written to ``RUN/scores/NAME.jsonl`` as they come. What is there already is not graded again, but for
    episodes for which the grader failed: the same call goes on where one was interrupted.

    Args:
        run: A run, or its folder or file.
        grader: A function of an ``Episode`` that returns True or False, a number, several by name, or None where it
            cannot tell; or its name, ``"module:function"``; it may be a coroutine function. ``"env"``: the grading of
            the environment, made from its record. ``"openai:MODEL"``: a model that judges by a rubric.
        repeat: How many times each episode is graded.
        name: Name of the scores; by default that of the grader.
        rubric: What makes an episode pass, for a model; see ``gem_eval.scoring.judge.RUBRIC``.
        kwargs: Keyword arguments that records lack, for ``"env"``.
        options: Options of the model, as ``{"base_url": …}``.
        max_concurrency: Episodes at once, for coroutine functions and models; None for 64.
        overwrite: Grade all anew.
        on_graded: Called with how many have been graded now, and how many are to be.

    Raises:
        ArgumentError: There is no such run or grader; or other scores have this name.
        EpisodeFileError: The run cannot be read, or the scores cannot be written.
    """
    run = opened(run)
    if repeat < 1:
        raise ArgumentError(f"repeat must be a positive whole number, not {repeat}")
    require_episodes(run)
    refuse_seats(run.rows)
    found = find_grader(grader, rubric=rubric, kwargs=kwargs, options=options)
    file = ScoreFile.new_or_begun(run, name or found.name)
    try:
        if found.agent is not None:
            prepare_agent(found.agent)  # raises what would fail for every episode
        file.begin(found.described, overwrite=overwrite)
        todo = [
            (row, time)
            for row in run.rows
            for time in range(repeat)
            if row.error is None and ((there := file.graded.get((row.number, time))) is None or there.error is not None)
        ]
        done = itertools.count(1)

        def keep(asked: Asked, grade: Grade) -> None:
            file.add(replace(grade, episode=asked[0].number, repeat=asked[1]))
            if on_graded is not None:
                on_graded(next(done), len(todo))

        if found.asynchronous:
            run_sync(_grade_together(run, found, todo, max_concurrency or DEFAULT_CONCURRENCY, keep))
        else:
            _grade_in_turn(run, found, todo, keep)
    finally:
        file.close()
        if found.agent is not None:
            close_agent(found.agent)
    return rescored(run, name or found.name, file)


def rescored(run: Run, name: str, file: ScoreFile) -> Rescored:
    """Return the scores that a file holds."""
    rows = [row for row in run.rows if row.error is None]
    of_row = grouped(file.graded.values(), lambda grade: grade.episode)
    verdicts = {row.number: _verdict(of_row.get(row.number, [])) for row in rows}
    changed = [
        Changed(row, row.success, new)
        for row in rows
        if (new := verdicts[row.number]) is not None and row.success is not None and row.success != new
    ]
    by_task = grouped(rows, lambda row: (row.id, row.model))
    numbers = {each.row.number for each in changed}
    ratings = [[each.value for each in own if each.value is not None] for own in of_row.values()]
    return Rescored(
        run,
        name,
        file.path,
        file.graded,
        [_task_score(*task, own, of_row, numbers) for task, own in by_task.items()],
        changed,
        agreement(ratings) if any(len(each) > 1 for each in ratings) else None,
        len(run.rows) - len(rows),
    )


def _grade_in_turn(run: Run, grader: Grader, todo: Sequence[Asked], keep: Callable[[Asked, Grade], None]) -> None:
    for first in range(0, len(todo), _AT_ONCE):
        asked: list[Asked] = []
        episodes: list[Episode] = []
        for each in todo[first : first + _AT_ONCE]:
            try:
                episodes.append(run.episode(each[0]))
                asked.append(each)
            except EpisodeFileError as error:
                keep(each, Grade(error=str(error)))
        for place, grade in grader.grades(episodes):
            keep(asked[place], grade)


async def _grade_together(
    run: Run, grader: Grader, todo: Sequence[Asked], max_concurrency: int, keep: Callable[[Asked, Grade], None]
) -> None:
    """Ask a coroutine function for several episodes at once; grades are kept in order of completion."""
    room = asyncio.Semaphore(max_concurrency)

    async def graded(each: Asked) -> None:
        async with room:
            try:
                grade = await grader.grade_async(run.episode(each[0]))
            except EpisodeFileError as error:
                grade = Grade(error=str(error))
            keep(each, grade)

    try:
        async with asyncio.TaskGroup() as group:
            for each in todo:
                group.create_task(graded(each))
    except* EpisodeFileError as errors:  # the scores cannot be written
        raise errors.exceptions[0] from None


def _verdict(graded: Sequence[Grade]) -> bool | None:
    """Return the verdict of most repeats; None where they are no verdicts, or as many say the one as the other."""
    values = [each.value for each in graded if each.value is not None]
    if not values or any(value not in (0, 1) for value in values) or 2 * sum(values) == len(values):
        return None
    return 2 * sum(values) > len(values)


def _task_score(
    task: str, model: str, rows: Sequence[Row], of_row: Mapping[int, Sequence[Grade]], changed: set[int]
) -> TaskScore:
    new: dict[str, list[float]] = {}
    old: dict[str, list[float]] = {}
    unknown = errors = 0
    for row in rows:
        graded = of_row.get(row.number, [])
        values = [each.value for each in graded if each.value is not None]
        if values:
            new.setdefault(row.row, []).append(math.fsum(values) / len(values))
            if row.success is not None:
                old.setdefault(row.row, []).append(float(row.success))
        elif any(each.error is not None for each in graded):
            errors += 1
        elif graded:
            unknown += 1
    return TaskScore(
        task,
        model,
        sum(map(len, new.values())),
        rate(list(old.values())) if old else None,
        _estimate(list(new.values())),
        sum(row.number in changed for row in rows),
        unknown,
        errors,
    )


def _estimate(rows: list[list[float]]) -> Estimate | None:
    if not rows:
        return None
    return rate(rows) if all(0 <= value <= 1 for row in rows for value in row) else mean(rows)
