"""``DatasetEnv``: rows in, single-turn task out."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from gem_core.env import Env
from gem_core.errors import ArgumentError, DatasetError, GradingError
from gem_core.parsing import extract_last_boxed_answer, extract_last_tagged_answer
from gem_core.suggestions import did_you_mean
from gem_core.types import TERMINAL_STATE, Observation, ResetResult, StepResult

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Grade:
    """A verdict on one response.

    Args:
        reward: The reward of the turn.
        correct: Whether the task is solved.
        answer: What was read out of the response; None when there was nothing to read.
        info: More for ``info``, plain JSON.
    """

    reward: float
    correct: bool
    answer: str | None = None
    info: Mapping[str, Any] = field(default_factory=dict)


class DatasetEnv(Env):
    r"""Asks one row of a data set and grades the one response to it.

    As it stands, the answer in ``\boxed{}`` or ``<answer>`` must be the row's, letter for letter. A subclass, or the
    argument ``grade``, decides otherwise::

        register("math:Mine", "gem_core:DatasetEnv", rows=[{"question": "1+1?", "answer": "2"}])

    ``reset`` draws a row, all equally likely; ``reset(options={"index": 3})`` takes the one of that index, as a plan
    does that covers the whole data set. The rows are shared by all environments on them, never copied.

    Args:
        rows: A sequence of mappings, as a list of dictionaries or a ``datasets.Dataset``.
        question_key: Column of the question.
        answer_key: Column of the answer.
        id_key: Column of an id that is stable across versions of the data set; by default the index is the id.
        prompt_template: Text of the first observation; ``{question}`` stands for the question.
        grade: Called with the response and the row, returns a ``Grade``.

    Raises:
        DatasetError: There are no rows, or the first has not the columns; the message names those it has.
    """

    def __init__(
        self,
        rows: Sequence[Row],
        *,
        question_key: str = "question",
        answer_key: str = "answer",
        id_key: str | None = None,
        prompt_template: str = "{question}",
        grade: Callable[[str, Row], Grade] | None = None,
    ) -> None:
        super().__init__()
        self.rows = rows
        self.question_key = question_key
        self.answer_key = answer_key
        self.id_key = id_key
        self.prompt_template = prompt_template
        self._grade = grade
        self._index = 0
        self._check_rows()

    @property
    def num_tasks(self) -> int:
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
        self._index = self._chosen(options) if options else int(self.np_random.integers(self.num_tasks))
        row = self.rows[self._index]
        return self.prompt(row), {"task_id": self.task_id(self._index, row), "index": self._index}

    def step(self, action: str) -> StepResult:
        """Grade the response; the task is over."""
        row = self.rows[self._index]
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
        return self.prompt_template.replace("{question}", str(row[self.question_key]))

    def grade(self, action: str, row: Row) -> Grade:
        """Return the verdict on a response.

        Raises:
            GradingError: No verdict can be reached, whatever the response, as with a gold answer that is malformed.
        """
        if self._grade is not None:
            return self._grade(action, row)
        answer = extract_last_boxed_answer(action)
        if answer is None:
            answer = extract_last_tagged_answer(action)
        correct = answer == str(row[self.answer_key]).strip()
        return Grade(reward=float(correct), correct=correct, answer=answer)

    def task_id(self, index: int, row: Row) -> str:
        """Return what names a row across runs."""
        return str(index) if self.id_key is None else str(row[self.id_key])

    def sample_random_action(self) -> str:
        """Return the answer of a row drawn at random: well-formed, and rarely right."""
        row = self.rows[int(self.action_random.integers(self.num_tasks))]
        return f"\\boxed{{{row[self.answer_key]}}}"

    def _chosen(self, options: dict[str, Any]) -> int:
        wrong = [name for name in options if name != "index"]
        if wrong:
            raise ArgumentError(f"no option {wrong[0]!r}.{did_you_mean(wrong[0], ['index'])} There is: index")
        index = options["index"]
        # Samplers give whole numbers of NumPy too.
        number = operator.index(index) if hasattr(index, "__index__") and not isinstance(index, bool) else -1
        if not 0 <= number < self.num_tasks:
            raise ArgumentError(f"options['index'] must be from 0 to {self.num_tasks - 1}, not {index!r}")
        return number

    def _check_rows(self) -> None:
        try:
            count, first = len(self.rows), (self.rows[0] if len(self.rows) else None)
        except (TypeError, KeyError) as error:
            raise DatasetError(f"rows must be a sequence of mappings, not {type(self.rows).__name__}") from error
        if not count or first is None:
            raise DatasetError("the data set is empty; check its name, its split and any filter")
        if not isinstance(first, Mapping):
            raise DatasetError(f"a row must map columns to values, and the first is a {type(first).__name__}")
        for key in filter(None, (self.question_key, self.answer_key, self.id_key)):
            if key not in first:
                columns = ", ".join(map(repr, first))
                raise DatasetError(f"no column {key!r} in the data set.{did_you_mean(key, first)} Columns: {columns}")

    def _get_state(self) -> dict[str, Any]:
        return {"index": self._index}

    def _set_state(self, state: dict[str, Any]) -> None:
        self._index = self._chosen({"index": state["index"]})
