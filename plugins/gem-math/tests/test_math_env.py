"""``MathEnv``: gold answers of every column, rewards, errors, loading, and the ids that are registered."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from gem_core.errors import ArgumentError
from gem_core.testing import check_env, check_plugin
from gem_math import MathEnv, grade
from gem_math.listing import math_specs

ROW = {"question": "What is 6 times 7?", "answer": "42"}


def step(env: MathEnv, action: str) -> tuple[float, bool, bool, dict[str, Any]]:
    """Ask the first row and answer it; returns the reward, both flags and the info."""
    env.reset(seed=0, options={"index": 0})
    _, reward, terminated, truncated, info = env.step(action)
    return float(reward), terminated, truncated, info


def test_the_plugin_passes_its_checks():
    """It declares only, and what it declares is there."""
    assert check_plugin("gem-math")


def test_the_contract_holds():
    """math:Sample keeps to all that an environment promises."""
    check_env("math:Sample")


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("import gem_math, gem_math._plugin", {"mpmath", "sympy", "math_verify"}),
        ("import gem_math; gem_math.grade('1/2', '0.5'); gem_math.grade('2x', 'x+x')", {"sympy", "math_verify"}),
    ],
)
def test_what_takes_a_second_to_load_is_loaded_by_the_processes_alone(code: str, heavy: set[str]):
    """Neither the import nor a simple answer needs it."""
    code = f"import sys; {code}; print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_right_and_wrong_answers():
    """The reward is 1 or 0; info says the verdict, what was read, and why."""
    env = MathEnv([ROW])
    reward, terminated, truncated, info = step(env, r"Six sevens: \boxed{42.0}")
    assert (reward, terminated, truncated, info["correct"], info["parsed_action"]) == (1.0, True, False, True, "42.0")
    reward, _, _, info = step(env, r"\boxed{43}")
    assert (reward, info["correct"], info["reason"]) == (0.0, False, "it is not the reference")
    assert step(env, "<answer>42</answer>")[0] == 1.0
    assert step(env, r"\boxed{41} no, \boxed{42}")[0] == 1.0
    assert step(env, r"\boxed{42} no, \boxed{41}")[0] == 0.0


@pytest.mark.parametrize("response", ["42", "", "The answer is 42.", r"\boxed{42", "boxed{42}", "$42$"])
def test_response_without_a_box_is_wrong(response: str):
    """What is not in a box or tag is no answer, as with gem-llm."""
    reward, _, _, info = step(MathEnv([ROW]), response)
    assert (reward, info["parsed_action"], info["reason"]) == (0.0, None, "there is no \\boxed{} and no <answer>")


def test_format_rewards():
    """Off by default; the peer's -0.1 for a response without a box is one keyword away."""
    env = MathEnv([ROW], format_reward=0.25, format_error_reward=-0.1)
    assert step(env, "42")[0] == -0.1
    assert step(env, r"\boxed{43}")[0] == 0.25
    assert step(env, r"\boxed{42}")[0] == 1.25


def test_length_penalty():
    """It grows with the response, and takes no more than 1."""
    env = MathEnv([ROW], length_penalty=0.1)
    assert step(env, r"\boxed{42}".rjust(2000))[0] == pytest.approx(0.8)
    assert step(env, r"\boxed{42}".rjust(1_000_000))[0] == 0.0
    assert step(MathEnv([ROW]), r"\boxed{42}".rjust(1_000_000))[0] == 1.0


@pytest.mark.parametrize(
    ("answer", "reward"),
    [("1, 2, 3, 4", 1.0), ("4, 2", 0.5), ("1, 2, 3, 5", 0.75), ("7", 0.0), ("2", 0.25), ("1,2,3,4,5", 0.0)],
)
def test_partial_credit(answer: str, reward: float):
    """The fraction of the parts that are right; none for one that lists more than there are."""
    env = MathEnv([{"question": "?", "answer": r"\{1, 2, 3, 4\}"}], partial_credit=True)
    found, _, _, info = step(env, rf"\boxed{{{answer}}}")
    assert (found, info["correct"]) == (reward, reward == 1.0)
    assert step(MathEnv([{"question": "?", "answer": "1,2,3,4"}]), rf"\boxed{{{answer}}}")[0] == float(reward == 1.0)


@pytest.mark.parametrize(
    "gold",
    ["6 * 7 = <<6*7=42>>42\n#### 42", "#### 42", 42, 42.0, ["41 + 1"], ["no", "42"], r"It is $\boxed{42}$.", "$42$"],
)
def test_forms_of_the_gold_column(gold: object):
    """GSM8K's mark, a box, a number, a list of which each is right."""
    env = MathEnv([{"question": "?", "answer": gold}])
    assert step(env, r"\boxed{42}")[0] == 1.0
    assert step(env, r"\boxed{43}")[0] == 0.0


def test_gold_answer_that_is_missing_is_an_error():
    """The episode is truncated, and the error says what is wrong with the gold answer."""
    empty = MathEnv([{"question": "?", "answer": "It is so.\n####"}])
    reward, terminated, truncated, info = step(empty, r"\boxed{1}")
    assert (reward, terminated, truncated) == (0.0, False, True)
    message = "nothing follows '####' in the gold answer 'It is so.\\n####'"
    assert info["error"] == {"kind": "grading", "message": message}
    assert "correct" not in info


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"timeout_s": 0}, "timeout_s must be above 0, not 0"),
        ({"timeout_s": float("inf")}, "timeout_s must be a finite number, not inf"),
        ({"format_reward": "1"}, "format_reward must be a finite number, not '1'"),
        ({"length_penalty": True}, "length_penalty must be a finite number, not True"),
    ],
)
def test_wrong_arguments(keywords: dict[str, Any], message: str):
    """Each says what was wrong and what is allowed."""
    with pytest.raises(ArgumentError) as caught:
        MathEnv([ROW], **keywords)
    assert str(caught.value) == message


def test_random_action_is_a_gold_answer_alone():
    """Of GSM8K's solutions only what follows the mark goes into the box."""
    env = MathEnv([{"question": "?", "answer": "long\n#### 42"}])
    env.reset(seed=0)
    assert env.sample_random_action() == r"\boxed{42}"


def test_ids_are_the_peers():
    """Ids, data sets and splits as gem-llm's registry has them."""
    peers = """math:ASDiv2K ASDIV-2k|math:GSM8K GSM-8k|math:Math12K MATH-12k|math:Math8K-3to5 MATH-lvl3to5-8k
        |math:Orz57K ORZ-57k|math:DeepScaleR40K DeepScaleR-40K|eval:MATH500 math-eval math|eval:AMC math-eval amc
        |eval:OlympiadBench math-eval olympiad_bench|eval:Minerva math-eval minerva|eval:AIME24 math-eval aime24"""
    expected = {env_id: rest for env_id, *rest in map(str.split, peers.split("|"))}
    specs = {spec.id: spec for spec in math_specs() if spec.id != "math:Sample"}
    assert specs.keys() == expected.keys()
    for env_id, spec in specs.items():
        name, *split = expected[env_id]
        columns = {"question_key": "problem", "answer_key": "answer"}
        assert spec.kwargs == {"dataset_name": f"axon-rl/{name}", **columns, **({"split": split[0]} if split else {})}
        assert spec.requires == ("hub",)


@pytest.mark.parametrize("text", ["The answer is 42.", "42", "Final answer: $42$", "So we get $x = 42$ in the end."])
def test_grade_reads_plain_text_too(text: str):
    """Without a box the function takes what follows 'the answer is', the last formula, or all of it."""
    assert grade(text, "42").correct
    assert not grade(text, "43").correct


@pytest.mark.parametrize(
    "text", ["The answer is not 42.", "It is not $42$.", "42 is wrong", "Is it 42?", "between 41 and 42"]
)
def test_grade_reads_no_answer_into_a_denial(text: str):
    """A text that denies the gold answer, or asks, does not give it."""
    assert not grade(text, "42").correct
