"""Functions: with given arguments, and with assertions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from counting import CountingRunner

from gem_core.errors import GradingError
from gem_tools.python import Limits

if TYPE_CHECKING:
    from judging import Judge

CHECK = """
def check(candidate):
    assert candidate(1) == 2
    assert candidate(2) == 4, "twice two"
    assert candidate(-3) == -6
"""


def test_humaneval_form(judge: Judge) -> None:
    """Each assertion is a test of its own."""
    verdict = judge("def twice(x):\n    return 2 * x", CHECK, "twice")
    assert (verdict.correct, len(verdict.tests)) == (True, 3)
    verdict = judge("def twice(x):\n    return x + 2 if x > 1 else 2", CHECK, "twice", every=True)
    assert [test.status for test in verdict.tests] == ["passed", "passed", "wrong_answer"]
    assert verdict.fraction == pytest.approx(2 / 3)


def test_mbpp_form(judge: Judge) -> None:
    """A list of assertions, which name the function themselves; several functions may be called."""
    tests = [
        "assert add(1, 2) == 3",
        "assert set(both([1], b=[2])) == {1, 2}",
        "import math",
        "assert math.isclose(add(0.1, 0.2), 0.3)",
    ]
    code = "def add(a, b):\n    return a + b\ndef both(a, b):\n    return a + b"
    assert judge(code, tests).correct
    verdict = judge(code.replace("def both", "def other"), tests, every=True)
    assert [test.status for test in verdict.tests] == ["passed", "runtime_error", "passed"]
    failed = verdict.first_failure
    assert failed is not None
    assert failed.error == "NameError: the program defines no function 'both'"


def test_calls_with_given_arguments(judge: Judge) -> None:
    """The form of TACO and APPS; a method of ``Solution`` counts too."""
    tests = {"fn_name": "add", "inputs": [[1, 2], [3, 4], [[5], [6]]], "outputs": [3, 7, [5, 6]]}
    assert judge("def add(a, b): return a + b", tests).correct
    assert judge("class Solution:\n    def add(self, a, b): return a + b", tests).correct
    verdict = judge("def add(a, b): return a + b if a != 3 else 0", tests, every=True)
    assert [test.status for test in verdict.tests] == ["passed", "wrong_answer", "passed"]
    verdict = judge("def sub(a, b): return a - b", tests)
    assert [test.status for test in verdict.tests] == ["runtime_error", "not_run", "not_run"]


def test_tests_that_end_their_process_are_no_failure_of_a_program(judge: Judge) -> None:
    """As ``unittest.main`` does."""
    tests = (
        "import unittest\nclass T(unittest.TestCase):\n    def test_f(self):\n        self.assertEqual(f(1), 1)\n"
        "unittest.main(argv=['x'])"
    )
    with pytest.raises(GradingError, match="they end their process"):
        judge("def f(x): return x", tests)


def test_a_problem_in_words_that_python_can_read_is_no_code(judge: Judge) -> None:
    """One word is an expression."""
    verdict = judge("def twice(x):\n    return 2 * x", CHECK, "twice", "Double")
    assert (verdict.correct, len(verdict.tests)) == (True, 3)


def test_results_that_a_row_wraps_in_lists(judge: Judge) -> None:
    """A list of one stands for what is in it only where all of a row's results are such lists."""
    code = "def add(a, b): return a + b"
    wrapped = {"fn_name": "add", "inputs": [[1, 2], [[5], [6]]], "outputs": [[3], [[5, 6]]]}
    assert judge(code, wrapped).correct
    once = {"fn_name": "add", "inputs": [[1, 2], [3, 4]], "outputs": [3, [7]]}
    verdict = judge(code, once, every=True)
    assert [test.status for test in verdict.tests] == ["passed", "wrong_answer"]


def test_tests_one_by_one_that_call_a_function(judge: Judge) -> None:
    """The forms of Prime Intellect and of LiveCodeBench, whose arguments are lines of JSON."""
    code = "def add(a, b): return a + b"
    listed = [{"type": "function_call", "fn_name": "add", "input": [1, 2], "output": [3]}]
    lines = [{"testtype": "functional", "input": '"1"\n"2"', "output": '"12"'}]
    for tests in (listed, lines):
        assert judge(code, tests, "add").correct
        assert judge(code.replace("+", "*"), tests, "add").status in ("wrong_answer", "runtime_error")


def test_a_class_solution_finds_what_its_sites_import(judge: Judge) -> None:
    """Answers to their problems leave the imports out; other programs have to import what they use."""
    tests = {"fn_name": "most", "inputs": [[[1, 2, 2]]], "outputs": [2]}
    method = (
        "def most({self}numbers: List[int]) -> Optional[int]:\n{indent}return Counter(numbers).most_common(1)[0][0]"
    )
    asked = f"class Solution:\n    {method.format(self='self, ', indent='        ')}"
    assert judge(asked, tests).correct
    assert judge(asked, "def check(candidate):\n    assert candidate([1, 2, 2]) == 2", "Solution().most").correct
    failed = judge(method.format(self="", indent="    "), tests).first_failure
    assert failed is not None
    assert failed.error == "NameError: name 'List' is not defined"


@pytest.mark.parametrize(
    "code",
    [
        "def twice(x):\n    return shift(x, x)",
        "    return shift(x, x)",
        "    return shift(x, Optional and x)",
        "twice = lambda x: shift(x, x)",
        "from operator import add\ndef shift(a, b): return add(a, b)\ndef twice(x): return shift(x, x)",
    ],
)
def test_a_prompt_that_is_code_comes_first(judge: Judge, code: str) -> None:
    """Its imports and helpers are there; a response may hold the whole function, or its body alone."""
    prompt = "from typing import Optional\n\ndef shift(a, b):\n    return a + b\n\n"
    prompt += "def twice(x: Optional[int]):\n    '''Doc.'''\n"
    assert judge(code, CHECK, "twice", prompt).correct


def test_helpers_of_the_prompt_are_the_tests_own(judge: Judge) -> None:
    """A program cannot change what the tests use of the prompt."""
    prompt = "def encode(x):\n    return x + 1\n\ndef decode(x):\n    '''Undo encode.'''\n"
    tests = "def check(candidate):\n    for x in range(5):\n        assert candidate(encode(x)) == x\n"
    assert judge("def decode(x): return x - 1", tests, "decode", prompt).correct
    assert not judge("def encode(x): return x\ndef decode(x): return x", tests, "decode", prompt).correct


@pytest.mark.parametrize(
    ("code", "status"),
    [
        ("def twice(x: return x", "compile_error"),
        ("def twice(x):\n    return \x00", "compile_error"),
        ("def twice(x):\n    return '\ud800'", "compile_error"),
        ("raise ValueError('no')", "runtime_error"),
        ("import sys\nsys.exit(0)", "runtime_error"),
        ("def other(x): return 1", "runtime_error"),
        ("def twice(x): raise MemoryError", "memory"),
        ("def twice(x): return 1 / 0", "runtime_error"),
        ("def twice(x): return object()", "runtime_error"),
        ("def twice(x): return twice(x)", "runtime_error"),
        ("def twice(x): return 3", "wrong_answer"),
        ("", "runtime_error"),
    ],
)
def test_reasons_of_failure_are_told_apart(judge: Judge, code: str, status: str) -> None:
    """In both forms of function tests."""
    calls = {"fn_name": "twice", "inputs": [[1]], "outputs": [2]}
    assert judge(code, CHECK, "twice").status == status
    assert judge(code, calls).status == status


@pytest.mark.thorough
def test_a_call_that_does_not_end_leaves_those_before_it(judge: Judge) -> None:
    """The answers until then count; the rest is not run."""
    code = "def twice(x):\n    while x < 0: pass\n    return 2 * x"
    tests = CHECK + "    assert candidate(5) == 10\n"
    limits = Limits(wall_s=4.0)
    verdict = judge(code, tests, "twice", every=True, limits=limits)
    assert [test.status for test in verdict.tests] == ["passed", "passed", "timeout", "not_run"]
    calls = {"fn_name": "twice", "inputs": [[1], [-1], [2]], "outputs": [2, -2, 4]}
    verdict = judge(code, calls, every=True, limits=limits)
    assert [test.status for test in verdict.tests] == ["passed", "timeout", "not_run"]


def test_errors_that_are_expected(judge: Judge) -> None:
    """The type of an exception arrives; one of the program's own arrives as another error."""
    tests = """
try:
    f(0)
    raised = None
except ValueError as error:
    raised = str(error)
except Exception as error:
    raised = type(error).__name__
assert raised == "no zero"
try:
    f(1)
except Exception as error:
    other = type(error).__name__
assert other == "ProgramError"
"""
    code = "class Own(Exception): pass\ndef f(x):\n    raise ValueError('no zero') if x == 0 else Own('x')"
    verdict = judge(code, tests, every=True)
    assert [test.status for test in verdict.tests] == ["passed", "passed", "passed", "passed"]


def test_pythons_own_exceptions_arrive_with_their_arguments(judge: Judge) -> None:
    """A key is no text, and a ``KeyError`` shows it as it is written."""
    tests = "try:\n    f({}, 'a')\n    seen = None\nexcept KeyError as error:\n    seen = [str(error), *error.args]\n"
    assert judge("def f(d, k): return d[k]", tests + "assert seen == [\"'a'\", 'a']").correct
    code = "class Odd(Exception):\n    args = property(lambda self: 1 / 0)\ndef f(d, k): raise UnicodeError(Odd())"
    assert judge(code, "try:\n    f(1, 2)\nexcept UnicodeError as error:\n    assert error").correct


def test_arguments_that_the_program_changes(judge: Judge) -> None:
    """The tests see the change, whatever the container."""
    tests = [
        "a = [3, 1, 2]",
        "assert f(a) is None",
        "assert a == [1, 2, 3]",
        "d = {'k': [2, 1]}",
        "f(d['k'])",
        "g(d)",
        "assert d == {}",
    ]
    code = "def f(a): a.sort()\ndef g(d): d.clear()"
    assert judge(code, tests).correct
    assert not judge("def f(a): sorted(a)\ndef g(d): pass", tests).correct


def test_tests_and_program_take_one_run(judge: Judge) -> None:
    """However many calls there are, and though they are other ones each time."""
    tests = "import time\ndef check(candidate):\n    for x in range(2000):\n"
    tests += "        y = x + time.perf_counter_ns()\n        assert candidate(y) == y * 2\n"
    runner = CountingRunner()
    assert judge("def f(x): return 2 * x", tests, "f", runner=runner).correct
    assert not judge(
        "n = 0\ndef f(x):\n    global n\n    n += 1\n    return 2 * x if n < 2000 else 0", tests, "f", runner=runner
    ).correct
    assert runner.runs == 2


def test_random_numbers_of_tests_are_the_same_each_time(judge: Judge) -> None:
    """Their generator has a seed, so that a verdict is the same again."""
    tests = "import random\nassert f(random.randint(0, 10**9)) is True"
    judge("def f(x): return True", tests)
    shown = [judge("def f(x): return x", tests).info()["first_failure"]["input"] for _ in range(2)]
    assert shown[0] == shown[1]


@pytest.mark.parametrize(
    ("tests", "entry", "message"),
    [
        ("assert f(1) ==", "f", "the tests are at fault: they are no Python: SyntaxError"),
        ("x = 1", "f", "the tests are at fault: they assert nothing"),
        ("assert True", "f", "the tests are at fault: they assert nothing"),
        ("def check(candidate):\n    pass", "f", "they assert nothing"),
        (CHECK, None, "the row names no function in 'entry_point'"),
        ("import no_such_module\nassert f(1) == 1", "f", "they fail outside of any test: ModuleNotFoundError"),
        ("assert f(object()) == 1", "f", "they call the program with a value of type object, which cannot be passed"),
        ("import os\nos._exit(0)", "f", "the tests ended without a result"),
        ("class B(f): pass\nassert B().x == 1", None, "they derive a class from one of the program's"),
    ],
    ids=lambda value: None if isinstance(value, str) and len(value) > 30 else str(value),
)
def test_tests_that_are_at_fault_are_no_verdict(judge: Judge, tests: str, entry: str | None, message: str) -> None:
    """The error says what is wrong with them."""
    with pytest.raises(GradingError) as caught:
        judge("def f(x): return 0", tests, entry)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("code", "tests"),
    [
        ("def f(x): raise ValueError", "r = f(1)\ndef test_it():\n    assert r == 1"),
        ("def f(x): raise SyntaxError", "r = f(1)\ndef test_it():\n    assert r == 1"),
        ("class A:\n    def __repr__(self): raise KeyError\ndef f(x): return [A()]", "assert f(1) == 2"),
        ("class A:\n    def __repr__(self): return 5\ndef f(x): return [A()]", "assert f(1) == 2"),
        ("def f(x): return 0", "import sys\nif f(1) != 2:\n    sys.exit(1)\nassert f(1) == 2"),
        ("def f(x): return 0", "import sys\nif f(1) != 2:\n    sys.exit()\nassert f(1) == 2"),
        ("def f(g): return g(1)", "assert f(lambda x: slice(x)) == 3"),
        (
            "import os, resource\nresource.prlimit(os.getppid(), resource.RLIMIT_NOFILE, (0, 0))\ndef f(x): return 0",
            "import wave\nassert f(1) == 2",
        ),
        (
            "import os, resource\nresource.prlimit(os.getppid(), resource.RLIMIT_AS, (1, 1))\ndef f(x): return 0",
            f"x = [{'0, ' * 100_000}]\nassert f(1) == 2",
        ),
    ],
)
def test_a_program_cannot_make_the_tests_seem_at_fault(judge: Judge, code: str, tests: str) -> None:
    """It would be left out of the scores. What it breaks in the tests' process is its own failure."""
    verdict = judge(code, tests, every=True)
    assert verdict.passed == 0
    assert verdict.tests


def test_a_program_cannot_say_that_it_failed_by_passing(judge: Judge) -> None:
    """What it writes on the pipe is no verdict, whatever words it uses."""
    code = 'import os\nfor d in range(3, 64):\n    try: os.write(d, b\'{"failed": "passed", "error": null}\\n\')\n'
    code += "    except OSError: pass\ndef f(x): return 0"
    assert judge(code, "for i in [1, 2]:\n    assert f(i) == i").status == "runtime_error"


def test_a_program_that_ends_passes_no_test_that_hides_it(judge: Judge) -> None:
    """As a bare ``except`` does."""
    tests = "try:\n    f(1)\nexcept:\n    pass\nassert f(2) == 1"
    assert judge("import os\ndef f(x): os._exit(0)", tests, every=True).passed == 0


def test_stop_iteration_does_not_end_a_loop_of_the_tests(judge: Judge) -> None:
    """Where nothing was asserted yet; iterators of the program's end by it, and a test may wait for it."""
    tests = "assert all(map(f, [1, 2]))\nfor out, expected in zip(map(f, [1]), [2]):\n    assert out == expected"
    assert judge("def f(x): raise StopIteration", tests, every=True).passed == 0
    waited = "try:\n    f(1)\n    assert False\nexcept StopIteration:\n    assert f"
    assert judge("def f(x): raise StopIteration", waited).correct


@pytest.mark.thorough
def test_tests_that_never_end_are_no_verdict(judge: Judge) -> None:
    """Whatever the program."""
    with pytest.raises(GradingError, match="the tests do not come to their end"):
        judge("def f(x): return 1", "while True: pass\nassert f(1)", limits=Limits(wall_s=0.5))


@pytest.mark.thorough
def test_answers_that_keep_the_tests_from_ending_are_the_programs_fault(judge: Judge) -> None:
    """Once ever more calls are made, and once the tests compute for ever on an answer."""
    limits = Limits(wall_s=1.0)
    verdict = judge("def f(x): return x", "n = 0\nwhile f(n) < 10**9: n += 1\nassert n", limits=limits)
    assert verdict.status == "timeout"
    verdict = judge("def f(x): return 10**9", "assert sum(range(f(1) * 10**9)) >= 0", limits=limits)
    assert verdict.status == "timeout"


def test_what_is_expected_is_not_shown(judge: Judge) -> None:
    """Neither the assertion nor its message."""
    verdict = judge("def f(x, y): return [x]", ["assert f(1, y='a') == 'secret', 'expected secret'"])
    assert verdict.info()["first_failure"] == {
        "index": 0,
        "status": "wrong_answer",
        "input": "f(1, y='a')",
        "output": "[1]",
        "error": None,
    }
    assert "secret" not in repr(verdict.info())


def test_what_a_program_prints_does_not_matter(judge: Judge) -> None:
    """Nor what it writes to the streams themselves."""
    code = "import os, sys\nprint('x' * 100000)\ndef twice(x):\n    print('[]')\n"
    code += "    os.write(1, b'{}')\n    sys.stdout.flush()\n    return 2 * x"
    assert judge(code, CHECK, "twice").correct


def test_standard_input_is_empty(judge: Judge) -> None:
    """A program that asks for more fails there, and does not hang."""
    assert judge("def twice(x): return input()", CHECK, "twice").status == "runtime_error"


def test_code_under_main_is_not_run(judge: Judge) -> None:
    """Functions are imported, not started."""
    code = "def twice(x): return 2 * x\nif __name__ == '__main__':\n    raise SystemExit(twice(int(input())))"
    assert judge(code, CHECK, "twice").correct
