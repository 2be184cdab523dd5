"""``CodeEnv``: from a response to a reward, and whose failure it was."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from counting import CountingRunner

import gem_core as gem
from gem_code import CodeEnv
from gem_code.runner import NoVerdictError
from gem_core.errors import ArgumentError, MissingRequirementError
from gem_tools.python import Limits, Outcome, shared_pool

ROWS = [
    {
        "problem": "Print twice the number.",
        "tests": json.dumps({"inputs": ["1\n", "20\n", "300\n"], "outputs": ["2\n", "40\n", "600\n"]}),
        "entry_point": None,
    },
    {
        "problem": "Write twice(x).",
        "tests": "def check(candidate):\n    assert candidate(1) == 2\n    assert candidate(2) == 4\n",
        "entry_point": "twice",
    },
    {"problem": "Malformed.", "tests": '{"inputs": ["1"]}', "entry_point": None},
    {"problem": "Also malformed.", "tests": "assert f(", "entry_point": None},
]
DOUBLE = "```python\nprint(2 * int(input()))\n```"


def answered(action: str, index: int = 0, **options: Any) -> tuple[float, bool, bool, dict[str, Any]]:
    """Return reward, flags and info of a response."""
    env = CodeEnv(ROWS, **options)
    env.reset(seed=0, options={"index": index})
    observation, reward, terminated, truncated, info = env.step(action)
    assert observation == gem.TERMINAL_STATE
    return reward, terminated, truncated, info


def test_a_right_program() -> None:
    """Reward 1, and everything about the tests in info, which is plain JSON."""
    reward, terminated, truncated, info = answered(f"Twice it is.\n{DOUBLE}\n")
    assert (reward, terminated, truncated) == (1.0, True, False)
    assert (info["task_id"], info["correct"], info["status"], info["passed"], info["total"]) == (
        "0",
        True,
        "passed",
        3,
        3,
    )
    assert info["tests"] == [{"index": index, "status": "passed"} for index in range(3)]
    assert info["parsed_action"] == "print(2 * int(input()))"
    assert info["sandbox"] in ("bubblewrap", "docker", "process")
    assert json.loads(json.dumps(info)) == info


def test_a_wrong_program() -> None:
    """Reward 0, and the first test that failed, without what was expected."""
    reward, _, _, info = answered("```python\nx = int(input())\nprint(x + 1 if x == 1 else x)\n```")
    assert (reward, info["correct"], info["status"]) == (0.0, False, "wrong_answer")
    assert (info["passed"], info["total"]) == (1, 3)
    assert info["first_failure"] == {
        "index": 1,
        "status": "wrong_answer",
        "input": "20\n",
        "output": "20\n",
        "error": None,
    }
    assert info["tests"][2] == {"index": 2, "status": "not_run"}


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ("```python\na\n```", "a"),
        ("```py\na\n```", "a"),
        ("```\na\n```", "a"),
        ("```python3\na\n```", "a"),
        ("```Python\na\n```", "a"),
        ("```python\na\n```\nthen\n```python\nb\n```", "b"),
        ("```python\na\n```\nIt prints:\n```text\n42\n```", "a"),
        ("```python\na\n```\n```cpp\nint a;\n```", "a"),
        ("<think>```python\na\n```</think>\n```python\nb\n```", "b"),
        ("<answer>```python\nb\n```</answer>", "b"),
        ("<answer>```python\nb```</answer> and ```c", "b"),
        ("It is ```py\nb\n``` then.", "b"),
        ("<think>I try\n```python\na\n```\n</think>No program.", None),
        ("<think>I try\n```python\na\n</think>\n```python\nb\n```", "b"),
        ("inline ```python``` only", None),
        ("1. Like this:\n   ```python\n   if a:\n       b\n   ```", "if a:\n    b"),
        ("~~~python\na\n~~~", "a"),
        ("```python\n```", ""),
        ("```python\nnever closed", None),
        ("```cpp\nint a;\n```", None),
        ("print(1)", None),
        ("", None),
    ],
)
def test_the_answer_is_the_last_block_of_python(action: str, code: str | None) -> None:
    """Or of no language at all; blocks of other languages are no answers."""
    assert CodeEnv(ROWS).program(action) == code


def test_a_response_without_a_program() -> None:
    """As the peer rewards it, or as asked for; nothing is run."""
    reward, terminated, _, info = answered("I do not know.")
    assert (reward, terminated, info["correct"], info["status"]) == (-0.1, True, False, "no_code")
    assert info["parsed_action"] is None
    assert answered("I do not know.", format_error_reward=0.0)[0] == 0.0


def test_a_fraction_as_the_reward() -> None:
    """All tests are run then; only all of them are correct."""
    reward, _, _, info = answered("```python\nprint(2 * int(input()) % 100)\n```", reward="fraction")
    assert reward == pytest.approx(2 / 3)
    assert (info["correct"], info["passed"]) == (False, 2)
    reward, _, _, info = answered("```python\ndef twice(x): return 2\n```", 1, reward="fraction")
    assert (reward, info["total"]) == (0.5, 2)
    assert answered(DOUBLE, reward="fraction")[0] == 1.0


def test_max_tests_keeps_the_longest_inputs() -> None:
    """Their indices are those of the row."""
    _, _, _, info = answered("```python\nprint(600 if input() == '300' else 0)\n```", max_tests=2, reward="fraction")
    assert info["tests"] == [{"index": 1, "status": "wrong_answer"}, {"index": 2, "status": "passed"}]


def test_malformed_tests_are_an_error_that_names_the_row() -> None:
    """Whatever the response: no reward of 0, and nothing for training."""
    for action in (DOUBLE, "no program"):
        reward, terminated, truncated, info = answered(action, 2)
        assert (reward, terminated, truncated) == (0.0, False, True)
        assert info["error"] == {
            "kind": "grading",
            "message": "row 2 ('2'): the tests have no 'outputs'. Keys: 'inputs'",
        }
        assert "correct" not in info
    info = answered("```python\ndef f(): pass\n```", 3)[3]
    assert info["error"]["kind"] == "grading"
    assert info["error"]["message"].startswith("row 3 ('3'): the tests are at fault: they are no Python: SyntaxError")


def test_a_sandbox_that_fails_is_an_error() -> None:
    """And never a reward of 0."""

    class Broken:
        async def run(self, program: str, stdin: str, limits: Limits) -> Outcome:
            raise NoVerdictError("the sandbox failed: no space left")

    env = CodeEnv(ROWS)
    env.runner = Broken()
    for index in (0, 1):
        env.reset(options={"index": index})
        _, reward, terminated, truncated, info = env.step("```python\ndef twice(x): return x\n```")
        assert (reward, terminated, truncated) == (0.0, False, True)
        assert info["error"] == {"kind": "sandbox", "message": "the sandbox failed: no space left"}
        assert "correct" not in info


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("code", "status"),
    [
        ("while True: pass", "timeout"),
        ("x = bytearray(2**30)\nprint(len(x))", "memory"),
        ("while True: print('x' * 1000)", "output_limit"),
        ("print('x' * 30000)", "output_limit"),
        ("import time\ntime.sleep(60)", "timeout"),
        ("print(", "compile_error"),
        ("print(1 / 0)", "runtime_error"),
        ("import os\nos.abort()", "runtime_error"),
    ],
)
def test_limits_of_the_sandbox_are_verdicts(code: str, status: str) -> None:
    """What a program causes is its own failure."""
    seconds = 1.0 if status == "timeout" else 20.0
    options = {"timeout_s": seconds, "memory_mb": 128, "max_output_bytes": 20_000}
    reward, terminated, _, info = answered(f"```python\n{code}\n```", **options)
    assert (reward, terminated, info["status"]) == (0.0, True, status)
    assert "error" not in info


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("reward", "some", "'all' or 'fraction'"),
        ("max_tests", 0, "a whole number from 1 up, or None"),
        ("timeout_s", 1e7, "seconds above 0"),
        ("timeout_s", float("nan"), "seconds above 0"),
        ("memory_mb", True, "whole megabytes from 1 up"),
        ("max_output_bytes", -1, "whole bytes from 1 up"),
        ("float_tolerance", -0.1, "a number from 0 up, or None"),
        ("sandbox", "jail", "jail"),
    ],
)
def test_options_that_cannot_be_right_are_refused(name: str, value: Any, allowed: str) -> None:
    """With what is allowed, when the environment is made."""
    with pytest.raises(ArgumentError, match=re.escape(allowed)):
        CodeEnv(ROWS, **{name: value})


@pytest.mark.parametrize("level", ["bubblewrap", "process"])
def test_levels_of_isolation(level: str) -> None:
    """Either grades both forms, and info names it."""
    try:
        shared_pool(sandbox=level).start()
    except MissingRequirementError as error:
        pytest.skip(str(error))
    for index, code in enumerate(("print(2 * int(input()))", "def twice(x): return 2 * x")):
        reward, _, _, info = answered(f"```python\n{code}\n```", index, sandbox=level)
        assert (reward, info["sandbox"]) == (1.0, level)
        reward, _, _, info = answered("```python\nimport os\nos._exit(0)\n```", index, sandbox=level)
        assert (reward, info["sandbox"]) == (0.0, level)


def test_tolerance_is_an_option() -> None:
    """Outputs are compared as asked for."""
    rows = [{"problem": "p", "tests": {"inputs": ["", ""], "outputs": ["0.5 1\n", "0.5 1\n"]}}]
    action = "```python\nprint(0.5000001)\nprint(1)\n```"
    for options, reward in (({}, 0.0), ({"float_tolerance": 1e-6}, 1.0)):
        env = CodeEnv(rows, **options)
        env.reset(seed=0)
        assert env.step(action)[1] == reward


def test_a_program_that_is_too_long_is_not_run() -> None:
    """Nor held in memory many times over."""
    env = CodeEnv(ROWS)
    env.runner = runner = CountingRunner()
    for index in (0, 1):
        env.reset(options={"index": index})
        info = env.step("```python\n" + "#" * 1_100_000 + "\n```")[4]
        assert info["status"] == "compile_error"
    assert runner.runs == 0


def test_gold_action_is_the_solution_of_the_row() -> None:
    """A whole program, or a body that completes the question; none without a column of that name."""
    whole = {"problem": "def one():\n", "tests": "assert one() == 1", "entry_point": "one"}
    rows = [whole | {"solution": "def one():\n    return 1\n"}, whole | {"solution": "    return 1\n"}, whole]
    env = gem.make("code:Sample", dataset_name=None, rows=rows, id_key=None)
    golds = []
    for index in range(3):
        env.reset(options={"index": index})
        golds.append(env.gold_action())
    assert golds == ["```python\ndef one():\n    return 1\n\n```"] * 2 + [None]
    assert env.unwrapped.grade(golds[0], rows[0]).correct
