"""What grades: a function, an environment, or a model."""

from __future__ import annotations

import hashlib
import inspect
import math
import re
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gem_core import Episode
from gem_core.errors import ArgumentError, GemError, GradingError
from gem_core.records import to_plain
from gem_core.registry import load_entry_point
from gem_core.rollouts import Agent, close_agent, current_folder_importable, load_agent, prepare_agent
from gem_eval.replaying.recorded import differences
from gem_eval.replaying.replay import repeat_all
from gem_eval.scoring.judge import RUBRIC, SYSTEM, model_judge
from gem_eval.turns import error_text

Verdict = bool | float | Mapping[str, bool | float] | None
"""What a function returns: whether the episode passes, a score, several by name, or None where it cannot tell."""
GradeFunction = Callable[[Episode], Verdict | Awaitable[Verdict]]

_MODEL_PREFIX = "openai:"
_ENV = "env"


@dataclass(frozen=True)
class Grade:
    """What a grader said of an episode.

    Args:
        value: The score; a verdict is 0 or 1. None where it cannot tell, or failed.
        metrics: All that it returned, where it returned several.
        error: Why it failed.
        note: What it said besides.
    """

    value: float | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    error: str | None = None
    note: str | None = None


class Grader:
    """Calls a function for each episode.

    Args:
        name: What its scores are called by default.
        function: Called with an episode; plain or a coroutine function.
        described: What it is, for the file of scores: others of that name are told apart by it.
        agent: A model that it asks, to be prepared and closed.
    """

    def __init__(
        self, name: str, function: Callable[[Episode], Any], described: Mapping[str, Any], agent: Agent | None = None
    ) -> None:
        self.name, self.described = name, described
        self._function, self._agent = function, agent
        self.asynchronous = inspect.iscoroutinefunction(function) or inspect.iscoroutinefunction(
            getattr(function, "__call__", None)  # noqa: B004 - inspected, not called
        )

    def prepare(self) -> None:
        """Raise what would fail for every episode."""
        if self._agent is not None:
            prepare_agent(self._agent)

    def close(self) -> None:
        """Close the model that it asks."""
        if self._agent is not None:
            close_agent(self._agent)

    def grades(self, episodes: Sequence[Episode]) -> Iterator[tuple[int, Grade]]:
        """Yield the grade of each episode with its place; a plain function's only."""
        for place, episode in enumerate(episodes):
            try:
                graded = as_grade(self._function(episode))
            except Exception as error:  # noqa: BLE001 - third-party code may raise anything
                graded = Grade(error=_told(error))
            yield place, graded

    async def grade_async(self, episode: Episode) -> Grade:
        """Return the grade of an episode, of a coroutine function."""
        try:
            returned: Any = self._function(episode)
            verdict = await returned
            note = None
            if isinstance(verdict, tuple):  # of a judge, with its reason
                verdict, note = verdict
            graded = as_grade(verdict)
            return Grade(graded.value, graded.metrics, None, note)
        except Exception as error:  # noqa: BLE001 - third-party code may raise anything
            return Grade(error=_told(error))


class EnvGrader(Grader):
    """The environment's own grading: each episode is replayed in an environment made from its record.

    The value is success, or the return where a task does not tell.

    Args:
        kwargs: Keyword arguments of the environments that the records lack.
    """

    def __init__(self, kwargs: Mapping[str, Any] | None = None) -> None:
        self._kwargs = dict(kwargs or {})
        super().__init__(_ENV, lambda episode: None, {"grader": _ENV, "kwargs": self._kwargs})

    def grades(self, episodes: Sequence[Episode]) -> Iterator[tuple[int, Grade]]:
        """Yield the grade of each episode with its place, in any order."""
        for place, replayed in repeat_all(episodes, self._kwargs):
            if isinstance(replayed, GemError):
                yield place, Grade(error=_told(replayed))
            elif replayed.error is not None:
                yield place, Grade(error=error_text(replayed.error))
            else:
                yield place, _replayed_grade(episodes[place], replayed)


def _replayed_grade(recorded: Episode, replayed: Episode) -> Grade:
    found = differences(recorded, replayed, recorded.turns)
    metrics = {"return": replayed.episode_return}
    if replayed.success is not None:
        metrics = {"success": float(replayed.success), **metrics}
    value = next(iter(metrics.values()))
    return Grade(value, metrics, None, f"not as recorded: {found[0]}" if found else None)


def find_grader(
    grader: str | GradeFunction,
    *,
    rubric: str | None = None,
    kwargs: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Grader:
    """Return what grades.

    Args:
        grader: ``"module:function"`` or a function; ``"env"``; or ``"openai:MODEL"``.
        rubric: What makes an episode pass, for a model.
        kwargs: Keyword arguments of environments that records lack, for ``"env"``.
        options: Options of the model, as ``{"base_url": …}``.

    Raises:
        ArgumentError: There is no such grader, or an option is for another kind.
        EntryPointError: There is no such function.
    """
    is_model = isinstance(grader, str) and grader.startswith(_MODEL_PREFIX)
    if not is_model and (rubric is not None or options):
        raise ArgumentError(f"a rubric, and options of a model, are for --grader openai:MODEL, not {grader!r}")
    if grader != _ENV and kwargs:
        raise ArgumentError(f"arguments of the environment are for --grader env, not {grader!r}")
    if grader == _ENV:
        return EnvGrader(kwargs)
    if not isinstance(grader, str):
        name = getattr(grader, "__name__", type(grader).__name__)
        return Grader(_file_name(name), grader, {"grader": name, "code": _code_hash(grader)})
    if is_model:
        agent = load_agent(grader, system=SYSTEM, **(options or {}))
        text = RUBRIC if rubric is None else rubric
        told = {"grader": grader, "rubric": text, "system": SYSTEM, "options": to_plain(dict(options or {}))}
        return Grader(_file_name(grader), model_judge(agent, text), told, agent)
    if ":" not in grader:
        raise ArgumentError(f"no grader {grader!r}: give 'module:function', 'env' or 'openai:MODEL'")
    with current_folder_importable():
        function = load_entry_point(grader, "grader")
    return Grader(_file_name(grader), function, {"grader": grader, "code": _code_hash(function)})


def as_grade(returned: Any) -> Grade:
    """Return what a function returned as a grade.

    Raises:
        GradingError: It is none.
    """
    if returned is None:
        return Grade()
    if isinstance(returned, Mapping):
        metrics = {str(name): _number(value) for name, value in returned.items()}
        if not metrics:
            raise GradingError("the grader returned no metrics; return None where it cannot tell")
        return Grade(next(iter(metrics.values())), metrics)
    return Grade(_number(returned))


def _number(value: Any) -> float:
    if isinstance(value, np.generic):
        value = value.item()
    if not isinstance(value, bool | int | float) or not math.isfinite(value):
        raise GradingError(
            f"a grader returns True or False, a finite number, several of them by name, or None, not {value!r:.100}"
        )
    return float(value)


def _told(error: Exception) -> str:
    text = str(error) if isinstance(error, GemError) else f"{type(error).__name__}: {error}"
    return text[:500]


def _file_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "-", name, flags=re.ASCII).strip("-.") or "scores"


def _code_hash(function: Any) -> str | None:
    """Return a hash of the file of a function, so that scores of its earlier forms are not mixed with those of now."""
    try:
        file = inspect.getsourcefile(function if inspect.isroutine(function) else type(function))
        return None if file is None else hashlib.sha256(Path(file).read_bytes()).hexdigest()
    except (TypeError, OSError):
        return None
