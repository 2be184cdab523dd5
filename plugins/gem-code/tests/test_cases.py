"""The forms in which rows have their tests."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_code.cases import AssertionTests, CallTests, StdinTests, longest, read_tests
from gem_core.errors import GradingError


@pytest.mark.parametrize(
    ("tests", "read"),
    [
        ({"inputs": ["1\n"], "outputs": ["2\n"]}, StdinTests(("1\n",), ("2\n",))),
        ('{"inputs": ["1"], "outputs": ["2"]}', StdinTests(("1",), ("2",))),
        ({"inputs": [["1", "2"]], "outputs": [["3"]]}, StdinTests(("1\n2",), ("3",))),
        ({"inputs": [5], "outputs": [6]}, StdinTests(("5",), ("6",))),
        ([{"input": "1", "output": "2", "type": "stdin_stdout"}], StdinTests(("1",), ("2",))),
        ({"fn_name": "f", "inputs": [[1, 2]], "outputs": [3]}, CallTests("f", ([1, 2],), (3,))),
        ({"func_name": "f", "inputs": ["1\n[2]"], "outputs": ["[3]"]}, CallTests("f", ([1, [2]],), ([3],))),
        ({"fn_name": "f", "inputs": [["1"]], "outputs": ["2"]}, CallTests("f", (["1"],), ("2",))),
        ({"input": ["1"], "output": ["2"]}, StdinTests(("1",), ("2",))),
        ({"language": "python", "test_cases": [{"input": "1", "output": "2"}]}, StdinTests(("1",), ("2",))),
        (
            [{"type": "function_call", "fn_name": "g", "input": [1, 2], "output": [3]}],
            CallTests("g", ([1, 2],), ([3],)),
        ),
        ([{"type": "stdin_stdout", "fn_name": None, "input": "1", "output": "2"}], StdinTests(("1",), ("2",))),
        ([{"testtype": "functional", "input": '"a"\n1', "output": "true"}], CallTests("f", (["a", 1],), (True,))),
        ([{"testtype": "stdin", "input": "1\n", "output": "2"}], StdinTests(("1\n",), ("2",))),
        (
            [{"testtype": "functional", "input": "1", "output": "2", "metadata": {"func_name": "g"}}],
            CallTests("g", ([1],), (2,)),
        ),
        ("assert f(1) == 2", AssertionTests("assert f(1) == 2", "f", "p")),
        (["assert f(1) == 2", "assert f(2) == 3"], AssertionTests("assert f(1) == 2\nassert f(2) == 3", "f", "p")),
        ("[f(x) for x in [1]]; assert f(1)", AssertionTests("[f(x) for x in [1]]; assert f(1)", "f", "p")),
    ],
)
def test_forms_are_told_apart(tests: Any, read: Any) -> None:
    """Inputs and outputs, as JSON text too, calls, and assertions."""
    assert read_tests(tests, entry="f", prompt="p") == read


@pytest.mark.parametrize(
    ("tests", "message"),
    [
        ("", "the tests are empty"),
        (None, "tests must be {'inputs': […], 'outputs': […]}, a list of {'input', 'output'}, or code with assertions"),
        ({}, "the tests have no 'inputs'. Keys: none"),
        ({"inputs": ["1"]}, "the tests have no 'outputs'. Keys: 'inputs'"),
        ({"inputs": ["1"], "outputs": []}, "the tests have 1 inputs and 0 outputs"),
        ({"inputs": [], "outputs": []}, "there are no tests"),
        ([], "there are no tests"),
        ({"inputs": "1", "outputs": ["1"]}, "the inputs of the tests must be a list, not str ('1')"),
        ({"inputs": [None], "outputs": ["1"]}, "an input or output must be text or a list of lines, not nothing"),
        (
            {"fn_name": "f", "inputs": [1], "outputs": [1]},
            "the list of its arguments, or a line of JSON for each, not int ('1')",
        ),
        ({"fn_name": "f", "inputs": ["1 2"], "outputs": [1]}, "or a line of JSON for each, not str ('1 2')"),
        ([{"stdin": "1", "output": "2"}], "test 0 has no 'input'. Keys: 'stdin', 'output'"),
        ([{"input": "1", "output": "2"}, {}], "test 1 has no 'input'. Keys: none"),
        (
            [{"input": "1", "output": "2"}, {"input": [1], "output": 2, "fn_name": "f"}],
            "some of the tests call a function, and some run a program",
        ),
        (
            [{"input": [1], "output": 2, "fn_name": "g"}, {"input": [1], "output": 2, "fn_name": "f"}],
            "the tests call several functions: 'f', 'g'",
        ),
        (
            [{"input": [1], "output": 2, "type": "function_call"}],
            "the tests call a function, and name it neither in 'fn_name' nor in the row's 'entry_point'",
        ),
        ('{"inputs": ["1"', "the tests are no JSON, and no code with assertions"),
        ([1, 2], "or code with assertions, not list ('[1, 2]')"),
    ],
)
def test_malformed_tests_are_named(tests: Any, message: str) -> None:
    """The error says what is wrong and what is expected."""
    with pytest.raises(GradingError) as caught:
        read_tests(tests)
    assert message in str(caught.value)


def test_longest_inputs_are_kept_in_their_order() -> None:
    """As the peer chooses them; of equally long ones the first."""
    tests = StdinTests(("a", "bbb", "cc", "dd", ""), ("1", "2", "3", "4", "5"))
    assert longest(tests, 2) == (StdinTests(("bbb", "cc"), ("2", "3")), [1, 2])
    assert longest(tests, None) == (tests, [0, 1, 2, 3, 4])
    assert longest(tests, 12) == (tests, [0, 1, 2, 3, 4])
    calls = CallTests("f", ([1], [1, 2, 3]), (1, 2))
    assert longest(calls, 1) == (CallTests("f", ([1, 2, 3],), (2,)), [1])


_KEYS = ["inputs", "outputs", "fn_name", "input", "output", "type", "testtype", "metadata", "func_name", "test_cases"]
_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(_KEYS), inner),
    max_leaves=10,
)


@given(_JSON | st.text())
def test_any_column_gives_tests_or_a_grading_error(value: Any) -> None:
    """Whatever a data set holds there, as it is or as JSON text."""
    for tests in (value, json.dumps(value)):
        try:
            read = read_tests(tests)
        except GradingError:
            continue
        assert isinstance(read, StdinTests | CallTests | AssertionTests)
