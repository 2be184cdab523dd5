"""``DatasetEnv``: rows in, single-turn task out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import gem_core as gem
from gem_core.errors import ArgumentError, DatasetError, GradingError
from gem_core.making.again import Recipe

ROWS = [{"question": f"{number}+1?", "answer": str(number + 1), "name": f"row-{number}"} for number in range(5)]


def test_row_is_chosen_by_index() -> None:
    """``options={"index": i}`` asks row i and names it."""
    env = gem.DatasetEnv(ROWS, id_key="name")
    for index in (3, np.int64(3)):  # as samplers give it
        observation, info = env.reset(options={"index": index})
        assert (observation, info, type(info["index"])) == ("3+1?", {"task_id": "row-3", "index": 3}, int)


def test_row_is_drawn_by_seed_without_options() -> None:
    """The same seed asks the same row, and every row is asked in time."""
    env = gem.DatasetEnv(ROWS)
    assert env.reset(seed=7) == env.reset(seed=7)
    assert {env.reset(seed=seed)[1]["index"] for seed in range(100)} == set(range(5))


@pytest.mark.parametrize(
    ("action", "answer"),
    [("so \\boxed{ 4 }", "4"), ("<answer>4</answer>", "4"), ("\\boxed{5}", "5"), ("4", None), ("", None)],
)
def test_default_grade_compares_the_boxed_or_tagged_answer(action: str, answer: str | None) -> None:
    """Letter for letter, white space around it apart; a response without an answer has none."""
    env = gem.DatasetEnv(ROWS)
    env.reset(options={"index": 3})
    observation, reward, terminated, truncated, info = env.step(action)
    assert (observation, reward, terminated, truncated) == (gem.TERMINAL_STATE, float(answer == "4"), True, False)
    assert (info["correct"], info["parsed_action"]) == (answer == "4", answer)


def test_own_grade_and_template() -> None:
    """A callable decides, and a template asks."""

    def grade(action: str, row: Any) -> gem.Grade:
        return gem.Grade(0.5, action == row["answer"], action, {"why": "partial"})

    env = gem.DatasetEnv(ROWS, prompt_template="Q: {question} {x}", grade=grade)
    assert env.reset(options={"index": 0})[0] == "Q: 0+1? {x}"
    info = env.step("1")[4]
    assert info == {"task_id": "0", "index": 0, "why": "partial", "correct": True, "parsed_action": "1"}


def test_a_grader_that_fails_is_an_error_and_no_reward() -> None:
    """The episode is truncated and left out of scores."""

    def grade(action: str, row: Any) -> gem.Grade:
        raise GradingError("the gold answer cannot be parsed")

    env = gem.DatasetEnv(ROWS, grade=grade)
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step("1")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert info["error"] == {"kind": "grading", "message": "the gold answer cannot be parsed"}
    assert "correct" not in info


@pytest.mark.parametrize("options", [*({"index": index} for index in (-1, 5, 1.0, "1", True, None)), {"indx": 1}])
def test_index_out_of_range_is_refused(options: Any) -> None:
    """The error names the range, or the option that there is."""
    with pytest.raises(ArgumentError, match=r"from 0 to 4|'index'"):
        gem.DatasetEnv(ROWS).reset(options=options)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "no row"),
        ([{"q": "a", "answer": "b"}], "Columns: 'q', 'answer'"),
        ([{"question": "a", "answers": "b"}], "Did you mean 'answers'?"),
        ([3], "int"),
        (3, "int"),
        ({}, "no row"),
        ({"a": 1}, "int"),
    ],
)
def test_rows_that_cannot_be_asked_are_refused(rows: Any, message: str) -> None:
    """The error names what is there."""
    with pytest.raises(DatasetError) as caught:
        gem.DatasetEnv(rows)
    assert message in str(caught.value)


def test_rows_are_shared_not_copied() -> None:
    """Siblings and remade environments hold the same rows."""
    env = gem.make("toy:Sums-v0")
    rows = env.unwrapped.rows
    assert Recipe.of(env).make().unwrapped.rows is rows  # type: ignore[attr-defined]
    assert env.spec is not None
    assert env.spec.make().unwrapped.rows is rows


def test_sampled_action_has_the_right_form() -> None:
    """It is the boxed answer of some row."""
    env = gem.DatasetEnv(ROWS)
    env.reset(seed=0)
    assert gem.extract_last_boxed_answer(env.sample_random_action()) in {row["answer"] for row in ROWS}


def test_fork_grades_against_the_same_row() -> None:
    """It holds the row of the episode, and shares all of them."""
    env = gem.DatasetEnv(ROWS)
    env.reset(seed=0, options={"index": 3})
    other = env.fork()
    assert other.step("\\boxed{4}")[1] == 1.0
    assert other.rows is env.rows


def test_template_fills_its_places_alone() -> None:
    """In one pass: what fills them is not read again; one that shows nothing of a row is refused."""
    rows = [{"question": "{level} of {question} in \\frac{1}{2}", "answer": "1", "level": "{answer}"}]
    env = gem.DatasetEnv(rows, prompt_template="{level}: {question} {}{{x}}")
    assert env.reset()[0] == "{answer}: {level} of {question} in \\frac{1}{2} {}{{x}}"
    with pytest.raises(ArgumentError, match=r": \{question\}, \{name\}$"):
        gem.DatasetEnv(ROWS, prompt_template="Solve {questoin}: {answer}")


def test_later_row_without_a_column_is_an_error_at_its_reset() -> None:
    """Columns of JSON lines may differ from row to row."""
    env = gem.DatasetEnv([{"question": "a", "answer": "b"}, {"question": "a"}])
    env.reset(options={"index": 0})
    with pytest.raises(DatasetError, match=r"'answer' in row 1 .*'question'"):
        env.reset(options={"index": 1})
