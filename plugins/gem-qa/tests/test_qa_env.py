"""``QAEnv``: what it asks, where it finds the answer, what it rewards."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_core.errors import ArgumentError
from gem_core.testing import check_env
from gem_qa import QAEnv

ROWS: list[dict[str, Any]] = [
    {"question": "Who painted The Night Watch?", "answer": ["Rembrandt", "Rembrandt van Rijn"]},
    {"question": "Where was Rembrandt born?", "answer": "Leiden"},
]


def graded(action: str, index: int = 0, **options: Any) -> tuple[float, dict[str, Any]]:
    """Return reward and info of one response."""
    env = QAEnv(ROWS, **options)
    env.reset(options={"index": index})
    observation, reward, terminated, truncated, info = env.step(action)
    assert observation == gem.TERMINAL_STATE
    assert terminated is not truncated
    return reward, info


def test_prompt_says_where_the_answer_goes() -> None:
    """Between tags, or in a box."""
    for boxed, place in ((False, "between <answer> and </answer>."), (True, "inside \\boxed{}.")):
        observation = QAEnv(ROWS, extract_boxed=boxed).reset(options={"index": 1})[0]
        assert observation.startswith("Where was Rembrandt born?\n\n")
        assert observation.endswith(place)


@pytest.mark.parametrize(
    ("action", "answer", "reward"),
    [
        ("<answer>Rembrandt</answer>", "Rembrandt", 1.0),
        ("I think <answer>Vermeer</answer>, no: <answer> rembrandt van Rijn. </answer>", "rembrandt van Rijn.", 1.0),
        ("\\boxed{Vermeer} <answer>Rembrandt</answer>", "Rembrandt", 1.0),
        ("<answer>\\boxed{\\text{Rembrandt}}</answer>", "Rembrandt", 1.0),
        ("<think><answer>Vermeer</answer>?</think>It is \\boxed{Rembrandt}.", "Rembrandt", 1.0),
        ("<think>So <answer>Rembrandt</answer></think>It is he.", None, 0.0),
        ("<think>So <answer>Rembrandt</answer>", None, 0.0),
        ("<answer>Rembrandt and Vermeer</answer>", "Rembrandt and Vermeer", 0.0),
        ("Rembrandt", None, 0.0),
        ("", None, 0.0),
    ],
)
def test_exact_match_is_the_reward(action: str, answer: str | None, reward: float) -> None:
    """Of the last answer between tags, or else the last box."""
    got, info = graded(action)
    assert (got, info["correct"], info["exact_match"], info["parsed_action"]) == (
        reward,
        reward == 1,
        reward == 1,
        answer,
    )


def test_box_comes_first_where_it_is_asked_for() -> None:
    """Tags are taken all the same."""
    assert graded("<answer>Vermeer</answer> \\boxed{Rembrandt}", extract_boxed=True)[0] == 1.0
    assert graded("<answer>Rembrandt</answer>", extract_boxed=True)[0] == 1.0


def test_f1_as_the_reward() -> None:
    """Whether it is correct is still exact match."""
    reward, info = graded("<answer>Rembrandt Harmenszoon van Rijn</answer>", reward="f1")
    assert reward == pytest.approx(6 / 7)
    assert (info["correct"], info["f1"], info["reason"]) == (False, reward, "it is none of the accepted answers")


def test_row_without_an_answer_is_an_error_and_no_reward() -> None:
    """Whatever the response was."""
    for action in ("<answer>x</answer>", ""):
        env = QAEnv([*ROWS, {"question": "What?", "answer": []}])
        env.reset(options={"index": 2})
        _, _, terminated, truncated, info = env.step(action)
        assert (terminated, truncated, info["error"]["kind"]) == (False, True, "grading")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reward": "bleu"}, "reward must be 'exact' or 'f1', not 'bleu'"),
        ({"judge_url": "http://x"}, "judge_url and judge_options belong to judge='openai:MODEL', and judge is None"),
        ({"judge": 3}, "judge must be a function, 'package.module:function' or 'openai:MODEL', not 3"),
        ({"judge": "openai:m", "judge_options": {"x": object()}}, "judge_options must be plain JSON"),
    ],
)
def test_wrong_arguments_are_named(options: dict[str, Any], message: str) -> None:
    """Before anything is asked."""
    with pytest.raises(ArgumentError) as caught:
        QAEnv(ROWS, **options)
    assert message in str(caught.value)


def test_environment_keeps_what_it_promises() -> None:
    """With sampled answers of the right form."""
    check_env("qa:Sample")
    env = QAEnv(ROWS[:1], extract_boxed=True)
    env.reset(seed=0)
    assert env.sample_random_action() == "\\boxed{Rembrandt}"
    assert env.step(env.sample_random_action())[1] == 1.0


@given(st.text(max_size=200))
def test_any_response_is_graded(action: str) -> None:
    """By a reward of 0 or 1, in either form."""
    for boxed in (False, True):
        assert graded(action, extract_boxed=boxed)[0] in (0.0, 1.0)
