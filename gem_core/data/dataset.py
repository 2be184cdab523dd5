"""``DatasetEnv``: a single-turn task from the rows of a data set."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypedDict, cast

from gem_core.data.rows import Row, RowFunction, RowSource, load_rows
from gem_core.env.base import Env
from gem_core.errors import ArgumentError, DatasetError, GradingError
from gem_core.parsing import extract_last_boxed_answer, extract_last_tagged_answer
from gem_core.registry.entry_points import load_entry_point
from gem_core.suggestions import did_you_mean
from gem_core.types import TERMINAL_STATE, Observation, ResetResult, StepResult

_PLACE = re.compile(r"\{([^{}]+)\}")


@dataclass(frozen=True)
class Grade:
    """A verdict on one response.

    Args:
        reward: The reward of the turn.
        correct: Whether the task is solved.
        answer: The answer found in the response; None if there is none.
        info: More for ``info``, plain JSON.
    """

    reward: float
    correct: bool
    answer: str | None = None
    info: Mapping[str, Any] = field(default_factory=dict)


class DatasetOptions(TypedDict, total=False):
    """The keywords of ``DatasetEnv``, for subclasses that add some: ``**options: Unpack[DatasetOptions]``."""

    dataset_name: str | Path | None
    split: str | None
    config: str | None
    revision: str | None
    row_filter: RowFunction | None
    map_row: RowFunction | None
    question_key: str
    answer_key: str
    id_key: str | None
    prompt_template: str


class DatasetEnv(Env):
    r"""Asks one row of a data set and grades the one response to it.

    As it stands, the answer in ``\boxed{}`` or ``<answer>`` must be the row's, letter for letter. A subclass, or the
    argument ``grade``, decides otherwise::

        register("math:Mine", "gem_core:DatasetEnv", rows=[{"question": "1+1?", "answer": "2"}])
        register("math:Ours", "gem_core:DatasetEnv", dataset_name="ours.jsonl", question_key="problem")

    ``reset`` draws a row, all equally likely; ``reset(options={"index": 3})`` takes the one of that index, as a plan
    does that covers the whole data set. The rows are shared by all environments on them, never copied.

    Args:
        rows: A sequence of mappings, as a list of dictionaries or a ``datasets.Dataset``; or what ``dataset_name``
            takes.
        dataset_name: Instead of ``rows``: the path of a file (JSON, JSON lines, CSV, Parquet) or folder, or a name on
            the Hugging Face hub; see ``gem_core.data.load_rows``.
        split: Which split of it, or part of one, as in ``"test[:100]"``; None if there is but one.
        config: Which subset of it.
        revision: Which version on the hub: a branch, a tag or a commit.
        row_filter: Called with each row; those for which it is false are left out. A function, or
            ``"package.module:function"``, by which environments share the result in worker processes too.
        map_row: Called with each row when it is asked, after ``row_filter``; returns the row to use instead.
        question_key: Column of the question.
        answer_key: Column of the answer.
        id_key: Column of an id that is stable across versions of the data set; by default the index is the id.
        prompt_template: Text of the first observation. ``{question}`` stands for the question, and ``{column}`` for
            any other column but that of the answer; other braces stay as they are.
        grade: Called with the response and the row, returns a ``Grade``; or ``"package.module:function"``.

    Raises:
        DatasetError: There are no rows, or the first has not the columns; the message names those it has.
        MissingRequirementError: Loading them needs the package ``datasets``, which is not installed.
        ArgumentError: Neither or both of ``rows`` and ``dataset_name``, or a template that shows nothing of a row.
    """

    shared_by_forks = ("rows", "_row")

    def __init__(
        self,
        rows: RowSource | None = None,
        *,
        dataset_name: str | Path | None = None,
        split: str | None = None,
        config: str | None = None,
        revision: str | None = None,
        row_filter: RowFunction | None = None,
        map_row: RowFunction | None = None,
        question_key: str = "question",
        answer_key: str = "answer",
        id_key: str | None = None,
        prompt_template: str = "{question}",
        grade: str | Callable[[str, Row], Grade] | None = None,
    ) -> None:
        super().__init__()
        if (rows is None) == (dataset_name is None):
            raise ArgumentError("give either rows or dataset_name: a list of rows, a path, or a name on the hub")
        self.rows = load_rows(
            cast("RowSource", dataset_name if rows is None else rows),
            split=split,
            config=config,
            revision=revision,
            row_filter=row_filter,
            map_row=map_row,
        )
        self.question_key = question_key
        self.answer_key = answer_key
        self.id_key = id_key
        self.prompt_template = prompt_template
        self._grade = load_entry_point(grade, "grade") if grade is not None else None
        self._name = repr(str(dataset_name)) if rows is None else "the rows"
        if not len(self.rows):
            raise DatasetError(f"no row in {self._name}; check its name, its split and any filter")
        self._take(0)
        if DatasetEnv.prompt(self, self._row) == prompt_template:
            places = ", ".join(f"{{{column}}}" for column in self._row if column != answer_key)
            raise ArgumentError(f"prompt_template shows nothing of a row: {prompt_template!r:.200}. Columns: {places}")

    @property
    def num_tasks(self) -> int:  # type: ignore[override]  # read from the rows, which a subclass may replace
        """Number of rows, each a task of its own."""
        return len(self.rows)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Ask a row.

        Args:
            seed: See ``Env.reset``.
            options: ``{"index": i}`` takes row ``i``, from 0.

        Raises:
            ArgumentError: An option that does not exist, or an index that is out of range.
        """
        super().reset(seed=seed)
        self._take(chosen_index(options, self.num_tasks) if options else int(self.np_random.integers(self.num_tasks)))
        return self.prompt(self._row), {"task_id": self.task_id(self._index, self._row), "index": self._index}

    def step(self, action: str) -> StepResult:
        """Grade the response; the task is over."""
        row = self._row
        info: dict[str, Any] = {"task_id": self.task_id(self._index, row), "index": self._index}
        try:
            grade = self.grade(action, row)
        except GradingError as error:
            info["error"] = {"kind": "grading", "message": str(error)}
            return TERMINAL_STATE, 0.0, False, True, info
        info |= {**grade.info, "correct": bool(grade.correct), "parsed_action": grade.answer}
        return TERMINAL_STATE, float(grade.reward), True, False, info

    def prompt(self, row: Row) -> Observation:
        """Return the first observation for a row."""

        def filled(place: re.Match[str]) -> str:
            column = self.question_key if place[1] == "question" else place[1]
            # The gold answer is no part of a question, and \\boxed{answer} a way to say where it goes.
            return str(row[column]) if column in row and column != self.answer_key else place[0]

        # In one pass, so that braces in a problem are never taken for places.
        return _PLACE.sub(filled, self.prompt_template)

    def grade(self, action: str, row: Row) -> Grade:
        """Return the verdict on a response.

        Raises:
            GradingError: No verdict can be reached, whatever the response, as with a gold answer that is malformed.
        """
        if self._grade is not None:
            return cast("Grade", self._grade(action, row))
        answer = extract_last_boxed_answer(action)
        if answer is None:
            answer = extract_last_tagged_answer(action)
        correct = answer == str(row[self.answer_key]).strip()
        return Grade(reward=float(correct), correct=correct, answer=answer)

    def task_id(self, index: int, row: Row) -> str:
        """Return the id of a row, stable across runs."""
        return str(index) if self.id_key is None else str(row[self.id_key])

    def task_row(self, index: int) -> Mapping[str, Any]:
        """Return a row with its ``task_id``; see ``Env.task_row``."""
        row = self.rows[index]
        return {**row, "task_id": self.task_id(index, row)}

    def sample_random_action(self) -> str:
        """Return the answer of a row drawn at random: well-formed, and rarely right."""
        row = self.rows[int(self.action_random.integers(self.num_tasks))]
        return self.gold_response(row) or "\\boxed{}"

    def gold_action(self) -> str | None:
        """Return a right response to the present row; None if it has no answer."""
        return self.gold_response(self._row)

    def gold_response(self, row: Row) -> str | None:
        """Return a right response to a row: its answer in a box; None if it has none.

        Raises:
            GradingError: The answer of the row is malformed.
        """
        answer = row[self.answer_key]
        return None if answer is None or not str(answer).strip() else boxed_or_tagged(str(answer))

    def _take(self, index: int) -> None:
        row = self.rows[index]
        if not isinstance(row, Mapping):
            raise DatasetError(f"row {index} must map columns to values, and is of type {type(row).__name__}")
        for key in (self.question_key, self.answer_key, self.id_key):
            if key is not None and key not in row:
                hint = f"{did_you_mean(key, row)} Columns: {', '.join(map(repr, row))}"
                raise DatasetError(f"no column {key!r} in row {index} of {self._name}.{hint}")
        self._index, self._row = index, row


def chosen_index(options: Mapping[str, Any], count: int) -> int:
    """Return the task that the options of a reset choose: ``{"index": i}``, with ``i`` from 0 to under ``count``.

    Raises:
        ArgumentError: Another option, or an index that is out of range.
    """
    wrong = [name for name in options if name != "index"]
    if wrong:
        raise ArgumentError(f"no option {wrong[0]!r}.{did_you_mean(wrong[0], ['index'])} There is: index")
    index = options["index"]
    # Samplers return integers of NumPy, too.
    number = operator.index(index) if hasattr(index, "__index__") and not isinstance(index, bool) else -1
    if not 0 <= number < count:
        raise ArgumentError(f"options['index'] must be from 0 to {count - 1}, not {index!r}")
    return number


def boxed_or_tagged(answer: str) -> str:
    r"""Return an answer in ``\boxed{}``, or between ``<answer>`` tags where its braces would break a box."""
    boxed = f"\\boxed{{{answer}}}"
    return boxed if extract_last_boxed_answer(boxed) == answer.strip() else f"<answer>{answer}</answer>"
