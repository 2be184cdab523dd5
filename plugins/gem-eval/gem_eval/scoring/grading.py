"""``score``: grade the episodes of a run again, and tell what changed."""

from __future__ import annotations

import asyncio
import inspect
import itertools
import math
import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from gem_core import Episode
from gem_core.background import run_sync, run_without_loop
from gem_core.errors import ArgumentError, EpisodeFileError, GemError, GradingError
from gem_core.records import to_plain
from gem_core.registry import load_entry_point
from gem_core.rollouts import Agent, close_agent, current_folder_importable, is_asynchronous, load_agent, prepare_agent
from gem_eval.grouping import grouped
from gem_eval.opening import opened, refuse_seats, require_episodes
from gem_eval.replaying.replay import differences, repeated
from gem_eval.running.provenance import code_of
from gem_eval.scoring.file import Grade, ScoreFile
from gem_eval.scoring.judge import RUBRIC, SYSTEM, model_judge
from gem_eval.statistics import Estimate, mean, rate
from gem_eval.turns import error_text

if TYPE_CHECKING:
    from gem_eval.records import Row, Run

DEFAULT_CONCURRENCY = 64

Verdict = bool | float | Mapping[str, bool | float] | Grade | None
"""What a grader returns: whether the episode passes, a score, several by name, or None where it cannot tell."""
GradeFunction = Callable[[Episode], Verdict | Awaitable[Verdict]]

_MODEL_PREFIX = "openai:"
_ENV = "env"


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
        new: Their new score.
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
        graded: What the grader said, by the number of the episode.
        tasks: Scores of each model on each task.
        changed: Episodes whose verdict changed.
        not_graded: Number of episodes that ended in an error, which are not graded.
    """

    run: Run
    name: str
    path: Path
    graded: Mapping[int, Grade]
    tasks: list[TaskScore]
    changed: list[Changed]
    not_graded: int

    @property
    def errors(self) -> dict[int, str]:
        """Why the grader failed, by the number of the episode."""
        return {number: each.error for number, each in self.graded.items() if each.error is not None}


class Grader(NamedTuple):
    """What grades episodes.

    Args:
        name: What its scores are called by default.
        described: What it is, for the file of scores: others of that name are told apart by it.
        function: Called with an episode, plain or a coroutine function.
        agent: A model that the function asks, to be prepared and closed.
    """

    name: str
    described: Mapping[str, Any]
    function: Any
    agent: Agent | None = None


def score(
    run: str | Path | Run,
    grader: str | GradeFunction,
    *,
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
        name: Name of the scores; by default that of the grader.
        rubric: What makes an episode pass, for a model; see ``gem_eval.scoring.judge.RUBRIC``.
        kwargs: Keyword arguments that records lack, for ``"env"``.
        options: Options of the model, as ``{"base_url": …}``.
        max_concurrency: Episodes at once, for all but plain functions; None for 64.
        overwrite: Grade all anew.
        on_graded: Called with how many have been graded now, and how many are to be.

    Raises:
        ArgumentError: There is no such run or grader; or other scores have this name.
        EpisodeFileError: The run cannot be read, or the scores cannot be written.
    """
    run = opened(run)
    require_episodes(run)
    refuse_seats(run.rows)
    found = find_grader(grader, rubric=rubric, kwargs=kwargs, options=options)
    file = ScoreFile(run, name or found.name)
    try:
        if found.agent is not None:
            prepare_agent(found.agent)  # raises what would fail for every episode
        file.begin(found.described, overwrite=overwrite)
        graded = {number for number, grade in file.graded.items() if grade.error is None}
        todo = [row for row in run.rows if row.error is None and row.number not in graded]
        done = itertools.count(1)

        async def grade(row: Row) -> None:
            file.add(row.number, await _grade(run, row, found.function))
            if on_graded is not None:
                on_graded(next(done), len(todo))

        if is_asynchronous(found.function):
            run_sync(_together(grade, todo, max_concurrency or DEFAULT_CONCURRENCY))
        else:
            for row in todo:
                run_without_loop(grade(row), "a plain function that grades cannot wait: define it by 'async def'")
    finally:
        file.close()
        if found.agent is not None:
            close_agent(found.agent)
    return rescored(run, name or found.name, file)


async def _together(grade: Callable[[Row], Awaitable[None]], rows: Sequence[Row], at_once: int) -> None:
    room = asyncio.Semaphore(at_once)

    async def graded(row: Row) -> None:
        async with room:
            await grade(row)

    try:
        async with asyncio.TaskGroup() as group:
            for row in rows:
                group.create_task(graded(row))
    except* EpisodeFileError as errors:  # the scores cannot be written
        raise errors.exceptions[0] from None


async def _grade(run: Run, row: Row, function: Callable[[Episode], Any]) -> Grade:
    """Return the grade of an episode; whatever fails is its error."""
    try:
        verdict = function(run.episode(row))
        return as_grade(await verdict if inspect.isawaitable(verdict) else verdict)
    except Exception as error:  # noqa: BLE001 - third-party code may raise anything
        text = str(error) if isinstance(error, GemError) else f"{type(error).__name__}: {error}"
        return Grade(error=text[:500])


def find_grader(
    grader: str | GradeFunction,
    *,
    rubric: str | None = None,
    kwargs: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Grader:
    """Return what grades; see ``score`` for the arguments.

    Raises:
        ArgumentError: There is no such grader, or an option is for another kind.
        EntryPointError: There is no such function.
    """
    is_model = isinstance(grader, str) and grader.startswith(_MODEL_PREFIX)
    if not is_model and (rubric is not None or options):
        raise ArgumentError(f"a rubric, and options of a model, are for --grader openai:MODEL, not {grader!r}")
    if grader != _ENV and kwargs:
        raise ArgumentError(f"arguments of the environment are for --grader env, not {grader!r}")
    if not isinstance(grader, str):
        name = getattr(grader, "__name__", type(grader).__name__)
        return Grader(_file_name(name), {"grader": name, "code": code_of([grader])}, grader)
    if grader == _ENV:
        own = dict(kwargs or {})

        async def by_env(episode: Episode) -> Grade:
            return await asyncio.to_thread(_grade_of_env, episode, own)

        return Grader(_ENV, {"grader": _ENV, "kwargs": own}, by_env)
    if is_model:
        agent = load_agent(grader, system=SYSTEM, **(options or {}))
        text = RUBRIC if rubric is None else rubric
        told = {"grader": grader, "rubric": text, "system": SYSTEM, "options": to_plain(dict(options or {}))}
        return Grader(_file_name(grader), told, model_judge(agent, text), agent)
    if ":" not in grader:
        raise ArgumentError(f"no grader {grader!r}: give 'module:function', 'env' or 'openai:MODEL'")
    with current_folder_importable():
        function = load_entry_point(grader, "grader")
        return Grader(_file_name(grader), {"grader": grader, "code": code_of([function])}, function)


def _grade_of_env(recorded: Episode, kwargs: Mapping[str, Any]) -> Grade:
    """Replay an episode: the value is success, or the return if its task does not tell."""
    (replayed,) = repeated(recorded, kwargs=kwargs)
    if replayed.error is not None:
        return Grade(error=error_text(replayed.error))
    found = differences(recorded, replayed, recorded.turns)
    metrics = {"return": replayed.episode_return}
    if replayed.success is not None:
        metrics = {"success": float(replayed.success), **metrics}
    note = f"not as recorded: {found[0]}" if found else None
    return Grade(value=next(iter(metrics.values())), metrics=metrics, note=note)


def as_grade(returned: Any) -> Grade:
    """Return what a function returned as a grade.

    Raises:
        GradingError: It is none.
    """
    if returned is None or isinstance(returned, Grade):
        return returned or Grade()
    if not isinstance(returned, Mapping):
        return Grade(value=_number(returned))
    metrics = {str(name): _number(value) for name, value in returned.items()}
    if not metrics:
        raise GradingError("the grader returned no metrics; return None where it cannot tell")
    return Grade(value=next(iter(metrics.values())), metrics=metrics)


def _number(value: Any) -> float:
    if isinstance(value, np.generic):
        value = value.item()
    if not isinstance(value, bool | int | float) or not math.isfinite(value):
        raise GradingError(
            f"a grader returns True or False, a finite number, several of them by name, or None, not {value!r:.100}"
        )
    return float(value)


def _file_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "-", name, flags=re.ASCII).strip("-.") or "scores"


def rescored(run: Run, name: str, file: ScoreFile) -> Rescored:
    """Return the scores that a file holds."""
    rows = [row for row in run.rows if row.error is None]
    changed = [
        Changed(row, row.success, bool(grade.value))
        for row in rows
        if (grade := file.graded.get(row.number)) and grade.value in (0, 1) and row.success not in (None, grade.value)
    ]
    by_task = grouped(rows, lambda row: (row.id, row.model))
    numbers = {each.row.number for each in changed}
    tasks = [_task_score(*task, own, file.graded, numbers) for task, own in by_task.items()]
    return Rescored(run, name, file.path, file.graded, tasks, changed, len(run.rows) - len(rows))


def _task_score(
    task: str, model: str, rows: Sequence[Row], graded: Mapping[int, Grade], changed: set[int]
) -> TaskScore:
    new: dict[str, list[float]] = {}
    old: dict[str, list[float]] = {}
    unknown = errors = 0
    for row in rows:
        grade = graded.get(row.number)
        if grade is None:
            continue
        if grade.value is not None:
            new.setdefault(row.row, []).append(grade.value)
            if row.success is not None:
                old.setdefault(row.row, []).append(float(row.success))
        errors += grade.error is not None
        unknown += grade.value is None and grade.error is None
    values = [value for each in new.values() for value in each]
    within = (0.0, 1.0) if all(0 <= value <= 1 for value in values) else None
    return TaskScore(
        task,
        model,
        len(values),
        rate(list(old.values())) if old else None,
        mean(list(new.values()), within=within) if new else None,
        sum(row.number in changed for row in rows),
        unknown,
        errors,
    )
