"""What grades: a function, an environment, or a model."""

from __future__ import annotations

import hashlib
import inspect
import math
import re
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gem_core import Episode
from gem_core.errors import ArgumentError, GemError, GradingError
from gem_core.records import to_plain
from gem_core.registry import load_entry_point
from gem_core.rollouts import Agent, current_folder_importable, load_agent
from gem_eval.replaying.recorded import differences
from gem_eval.replaying.replay import repeat_all
from gem_eval.scoring.file import Grade
from gem_eval.scoring.judge import RUBRIC, SYSTEM, model_judge
from gem_eval.turns import error_text

Verdict = bool | float | Mapping[str, bool | float] | None
"""What a function returns: whether the episode passes, a score, several by name, or None where it cannot tell."""
GradeFunction = Callable[[Episode], Verdict | Awaitable[Verdict]]

_MODEL_PREFIX = "openai:"
_ENV = "env"


@dataclass(frozen=True)
class Grader:
    """What grades episodes.

    Args:
        name: What its scores are called by default.
        described: What it is, for the file of scores: others of that name are told apart by it.
        function: Called with an episode, plain or a coroutine function; None for the episode's environment.
        kwargs: Keyword arguments of environments that records lack.
        agent: A model that the function asks, to be prepared and closed.
    """

    name: str
    described: Mapping[str, Any]
    function: Callable[[Episode], Any] | None = None
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    agent: Agent | None = None

    @property
    def asynchronous(self) -> bool:
        """Whether the function is a coroutine function."""
        called = getattr(self.function, "__call__", None)  # noqa: B004 - inspected, not called
        return inspect.iscoroutinefunction(self.function) or inspect.iscoroutinefunction(called)

    def grades(self, episodes: Sequence[Episode]) -> Iterator[tuple[int, Grade]]:
        """Yield the grades of episodes with their places, in any order, by a plain function or their environments.

        An environment is made from the record, and the episode is replayed in it. The value is success, or the return
        if its task does not tell.
        """
        if self.function is None:
            for place, replayed in repeat_all(episodes, self.kwargs):
                yield place, _replayed_grade(episodes[place], replayed)
            return
        for place, episode in enumerate(episodes):
            try:
                grade = as_grade(self.function(episode))
            except Exception as error:  # noqa: BLE001 - third-party code may raise anything
                grade = Grade(error=_told(error))
            yield place, grade

    async def grade_async(self, episode: Episode) -> Grade:
        """Return the grade of an episode by a coroutine function; a judge returns its reason as well."""
        function: Any = self.function
        try:
            verdict = await function(episode)
            verdict, note = verdict if isinstance(verdict, tuple) else (verdict, None)
            return replace(as_grade(verdict), note=note)
        except Exception as error:  # noqa: BLE001 - third-party code may raise anything
            return Grade(error=_told(error))


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
        return Grader(_ENV, {"grader": _ENV, "kwargs": dict(kwargs or {})}, kwargs=dict(kwargs or {}))
    if not isinstance(grader, str):
        name = getattr(grader, "__name__", type(grader).__name__)
        return Grader(_file_name(name), {"grader": name, "code": _code_hash(grader)}, grader)
    if is_model:
        agent = load_agent(grader, system=SYSTEM, **(options or {}))
        text = RUBRIC if rubric is None else rubric
        told = {"grader": grader, "rubric": text, "system": SYSTEM, "options": to_plain(dict(options or {}))}
        return Grader(_file_name(grader), told, model_judge(agent, text), agent=agent)
    if ":" not in grader:
        raise ArgumentError(f"no grader {grader!r}: give 'module:function', 'env' or 'openai:MODEL'")
    with current_folder_importable():
        function = load_entry_point(grader, "grader")
    return Grader(_file_name(grader), {"grader": grader, "code": _code_hash(function)}, function)


def as_grade(returned: Any) -> Grade:
    """Return what a function returned as a grade.

    Raises:
        GradingError: It is none.
    """
    if returned is None:
        return Grade()
    if not isinstance(returned, Mapping):
        return Grade(value=_number(returned))
    metrics = {str(name): _number(value) for name, value in returned.items()}
    if not metrics:
        raise GradingError("the grader returned no metrics; return None where it cannot tell")
    return Grade(value=next(iter(metrics.values())), metrics=metrics)


def _replayed_grade(recorded: Episode, replayed: Episode | GemError) -> Grade:
    if isinstance(replayed, GemError):
        return Grade(error=_told(replayed))
    if replayed.error is not None:
        return Grade(error=error_text(replayed.error))
    found = differences(recorded, replayed, recorded.turns)
    metrics = {"return": replayed.episode_return}
    if replayed.success is not None:
        metrics = {"success": float(replayed.success), **metrics}
    note = f"not as recorded: {found[0]}" if found else None
    return Grade(value=next(iter(metrics.values())), metrics=metrics, note=note)


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
