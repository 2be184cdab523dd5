"""Whose function a test calls, and what of a program's objects a test can see."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from judging import Judge

# As in MBPP+: inputs and results in lists, and a helper that compares them.
MBPP_PLUS = """
import numpy as np
from math import inf

def is_floats(x) -> bool:
    if isinstance(x, float):
        return True
    if isinstance(x, (list, tuple)):
        return all(isinstance(i, float) for i in x)
    if isinstance(x, np.ndarray):
        return x.dtype == np.float64 or x.dtype == np.float32
    return False

def assertion(out, exp, atol):
    if atol == 0 and is_floats(exp):
        atol = 1e-6
    if out != exp and atol != 0:
        assert np.allclose(out, exp, rtol=1e-07, atol=atol)
    else:
        assert out == exp, f"out: {{out}}, exp: {{exp}}"

inputs = {inputs}
results = {results}
for i, (inp, exp) in enumerate(zip(inputs, results)):
    assertion({name}(*inp), exp, 0)
"""
FOUND = """
def assertion(out, exp, atol):
    if isinstance(out, bool):
        exact_match = out == exp
    else:
        exact_match = exp == (out is not None)
    assert exact_match

for inp, exp in zip([['abb'], ['x']], [True, False]):
    assertion(f(*inp), exp, 0)
"""


@pytest.mark.parametrize(
    ("tests", "right", "wrong"),
    [
        (["assert sorted([3,1]) == [1,3]"], "def sorted(x): return [min(x), max(x)]", "def sorted(x): return x"),
        (["assert sorted([3,1]) == [1,3]"], "sorted = lambda x: [1, 3]", "def other(x): return x"),
        (["assert sum(10, 15) == 6", "assert sum(1, 2) == 1"], "def sum(a, b): return 6 if a > 1 else 1", "x = 1"),
        (["assert set(zip([1], [2])) == set([(1, 2)])"], "def zip(a, b): return [(1, 2)]", "def zip(a, b): return []"),
        (["assert abs(pow(2, 3, 1) - 9.0) < 1e-9"], "def pow(a, b, c): return 9.0", "def abs(x): return 0.0"),
        (["assert list([1, 2]) == [2, 1]"], "def list(x): return x[::-1]", "def list(x): return x"),
        (["assert str(5) == 'five'"], "def str(x): return 'five'", "x = 1"),
        (["x = max([1], [2])", "assert x == 3"], "def max(a, b): return a[0] + b[0]", "def max(a, b): return [2]"),
        (
            "def test_it():\n    values = [3, 1]\n    assert list(reversed(values, 0)) == [1, 3]",
            "def reversed(a, b): return a[::-1]",
            "def reversed(a, b): return a",
        ),
        (
            MBPP_PLUS.format(name="sum", inputs=[[10, 15], [100, 150]], results=[6, 93]),
            "def sum(a, b): return 6 if a == 10 else 93",
            "def zip(*a): return []\ndef enumerate(x): return []\ndef sum(a, b): return 6",
        ),
    ],
)
def test_a_function_may_be_named_like_one_of_pythons_own(judge: Judge, tests: object, right: str, wrong: str) -> None:
    """Where tests ask nothing else of the program, that function is tested, and not Python's."""
    assert judge(right, tests).correct
    assert not judge(wrong, tests).correct
    assert not judge("x = 1", tests).correct


@pytest.mark.parametrize(
    ("test", "planted"),
    [
        ("assert math.isclose(f(2), 2.5)", "class math: isclose = staticmethod(lambda *a, **k: True)"),
        ("assert isclose(f(2), 2.5)", "def isclose(*a): return True"),
        ("assert Counter(f(2)) == Counter('ab')", "def Counter(x): return 1"),
        ("assert re.fullmatch('[ab]+', str(f(2)))", "class re: fullmatch = staticmethod(lambda *a: True)"),
        ("assert datetime(2020, 1, 1) == f(2) < datetime.now()", "def datetime(*a): return 0"),
        ("import this\nassert f(2) == this.c", "open('this.py', 'w').write('c = 0')"),
        ("import numpy\nassert numpy.allclose(f(2), 2.5)", "open('numpy.py', 'w').write('allclose = max')"),
    ],
)
def test_names_of_the_library_are_the_judges(judge: Judge, test: str, planted: str) -> None:
    """Whether a test imports them or not, and whatever files the program leaves."""
    assert not judge(f"{planted}\ndef f(x): return 0", test).correct


@pytest.mark.parametrize(
    ("tests", "code"),
    [
        ("assert math.isclose(f(2), 2.5)", "def f(x): return x + 0.5"),
        ("assert Counter(f(2)) == Counter('ab')", "def f(x): return ['b', 'a']"),
        ("assert gcd(4, 6) == 2", "def gcd(a, b): return 2"),
        (
            "c = Counter()\nc.hit()\nassert c.hits == 1",
            "class Counter:\n    hits = 0\n    def hit(self): self.hits += 1",
        ),
        (
            "try:\n    assert f(0)\nexcept Overflow:\n    pass",
            "class Overflow(Exception): pass\ndef f(x): raise Overflow",
        ),
        ("assert f(3) == 6 and product(2, 3) == 6", "def product(a, b): return a * b\ndef f(x): return product(x, 2)"),
    ],
)
def test_right_programs_pass_beside_names_of_the_library(judge: Judge, tests: str, code: str) -> None:
    """A function that bears such a name is the program's where it is tested alone, or the question defines it."""
    prompt = "Write f, and `def product(a, b)`, which it calls." if "product" in tests else None
    verdict = judge(code, tests, prompt=prompt)
    assert verdict.correct, verdict.info()


def test_check_calls_its_candidate_and_pythons_own_functions(judge: Judge) -> None:
    """Also where the function under test has the name of one of these."""
    tests = "def check(candidate):\n    assert candidate(1, 2) == 3\n    assert max([1, candidate(1, 1)]) == 2\n"
    assert judge("def max(a, b): return a + b", tests, "max").correct
    assert judge("def max(*a): return 2", tests, "max", every=True).passed == 1


@pytest.mark.parametrize("name", ["sorted", "len", "set", "abs", "zip", "all"])
def test_what_judges_a_result_stays_pythons_own(judge: Judge, name: str) -> None:
    """A program that has such a function of its own cannot pass by it."""
    tests = [
        "assert sorted(f([2, 1])) == [1, 2] and len(f([2, 1])) == 2",
        "assert set(f([1])) == {1} and abs(f([1])[0] - 1) < 1",
        "assert all(a == b for a, b in zip(f([5]), [5]))",
    ]
    assert judge("def f(x): return x", tests, every=True).passed == 3
    wrong = f"import builtins\ndef {name}(*a): return [1, 2]\nbuiltins.{name} = {name}\ndef f(x): return 'ab'"
    assert judge(wrong, tests, every=True).passed == 0


@pytest.mark.parametrize(
    "helper",
    [
        "def same(add, other):\n    return add == other",
        "def same(a, b):\n    add = a - b\n    return add == 0",
        "def same(a, b):\n    return not [1 for add in [a] if add != b]",
        "same = lambda add, other: add == other",
        "class Same:\n    add = 1\n\ndef same(a, b):\n    return a == b",
    ],
)
def test_a_name_within_a_helper_hides_no_function(judge: Judge, helper: str) -> None:
    """Only what the tests define for all of them does."""
    tests = f"{helper}\nassert same(add(1, 2), 3)\nassert list(map(add, [1], [1])) == [2]"
    verdict = judge("def add(a, b): return a + b", tests, every=True)
    assert [test.status for test in verdict.tests] == ["passed", "passed"]
    assert judge("def add(a, b): return a - b", tests, every=True).passed == 0


@pytest.mark.parametrize(
    ("code", "tests"),
    [
        ("import re\ndef f(x): return re.search('ab', x)", FOUND),
        ("import re\ndef f(x): return re.match('ab', x)", "assert f('abc')\nassert not f('x')\nassert f('x') is None"),
        ("import re\ndef f(x): return [re.match('ab', x)]", "assert all(f('abc'))\nassert any(f('abc'))"),
        (
            "class A:\n    def __bool__(self): return False\ndef f(x): return A()",
            "assert not f(1)\nassert bool(f(1)) is False",
        ),
    ],
)
def test_the_truth_of_an_object_crosses(judge: Judge, code: str, tests: str) -> None:
    """Though the object itself does not, as a match of a regular expression."""
    verdict = judge(code, tests, every=True)
    assert verdict.correct, verdict.info()
    assert not judge("def f(x): return True", tests, every=True).correct


def test_an_object_is_equal_to_nothing(judge: Judge) -> None:
    """All but its truth is refused, and the reason says why."""
    code = "class A:\n    def __eq__(self, other): return True\n    __hash__ = None\ndef f(x): return A()"
    for test in (
        "assert f(1) == 1",
        "assert f(1) != 2",
        "assert [f(1)] == [1]",
        "assert 1 in [f(1)]",
        "assert f(1) > 0",
    ):
        verdict = judge(code, [test])
        assert verdict.status == "runtime_error"
        assert verdict.first_failure is not None
        assert verdict.first_failure.error == (
            "ProgramError: the program returned a value of type A, which is no plain data"
        )


def test_an_object_is_not_subtracted_from_what_is_expected(judge: Judge) -> None:
    """Its own difference from any number is nothing."""
    code = "class A:\n    def __sub__(self, other): return 0.0\n"
    code += "    __rsub__ = __truediv__ = __mod__ = __xor__ = __sub__\ndef f(x): return A()"
    tests = ["assert abs(f(1) - 2) < 1e-6", "assert abs(2 - f(1)) < 1e-6", "assert not f(1) ^ 5", "assert f(1) / 3 < 1"]
    verdict = judge(code, tests, every=True)
    assert [test.status for test in verdict.tests] == ["runtime_error"] * 4
    vector = "class V:\n    def __init__(self, x): self.x = x\n    def __mul__(self, by): return V(self.x * by)\n"
    vector += "    def __sub__(self, other): return V(self.x - other.x)"
    assert judge(vector, "assert (V(2) * 3 - V(1)).x == 5").correct


OBJECTS = """
class Stack:
    '''Of numbers.'''
    made = 0
    def __init__(self, items=()):
        Stack.made += 1
        self.items = list(items)
    def push(self, item):
        self.items.append(item)
        return self
    def pop(self):
        if not self.items:
            raise Empty("nothing there")
        return self.items.pop()
    def __len__(self): return len(self.items)
    def __iter__(self): return iter(self.items)
    def __getitem__(self, index): return self.items[index]
    def __eq__(self, other): return isinstance(other, Stack) and self.items == other.items
    def __add__(self, other): return Stack(self.items + other.items)
    def __str__(self): return f"Stack({self.items})"
    def __enter__(self): return self
    def __exit__(self, *_): self.items.clear()

class Empty(Exception): pass
class Odd(ValueError): pass

def f(x):
    import re
    return re.match("a(b)", x)
def size(stack): return len(stack.items)
def each(function, items): return [function(item) for item in items]
def odd(x): raise Odd(x)
"""


@pytest.mark.parametrize(
    "test",
    [
        "s = Stack()\ns.push(1).push(2)\nassert s.pop() == 2 and s.pop() == 1",
        "s = Stack([3, 4])\nassert len(s) == 2 and list(s) == [3, 4] and s[1] == 4 and 3 in s and s.items == [3, 4]",
        "assert Stack([1]) == Stack([1]) and Stack([1]) != Stack([2])",
        "assert str(Stack([1]) + Stack([2])) == 'Stack([1, 2])'",
        "s = Stack()\ns.items = [5]\nassert s.pop() == 5 and not s",
        "s = Stack([1])\nwith s as t:\n    assert t.pop() == 1",
        "Stack()\nassert Stack.made >= 1 and isinstance(Stack(), Stack) and not isinstance(3, Stack)",
        "assert size(Stack([1, 2])) == 2",
        "try:\n    Stack().pop()\n    assert False\nexcept Empty as error:\n    assert str(error) == 'nothing there'",
        "try:\n    odd('x')\nexcept ValueError as error:\n    assert str(error) == 'x'",
        "assert f('abc').group() == 'ab' and f('abc').group(1) == 'b' and f('x') is None and f('abc') != None",
        "assert each(lambda x: x + 1, [1, 2]) == [2, 3]",
        "assert each(size, [Stack(), Stack([1])]) == [0, 1]",
        "seen = []\neach(lambda x: seen.append(each(str, [x])), [1, 2])\nassert seen == [['1'], ['2']]",
    ],
)
def test_tests_use_objects_of_the_program(judge: Judge, test: str) -> None:
    """What is done with them is done in the program's process; functions of the tests may be passed to it."""
    verdict = judge(OBJECTS, test, every=True)
    assert verdict.correct, verdict.info()
    assert not judge("", test).correct


def test_a_function_of_the_tests_can_only_be_called(judge: Judge) -> None:
    """It does not lead the program to what is around it."""
    code = "def f(given):\n    try:\n        return given.__globals__['secret']\n    except Exception as error:\n"
    code += "        return type(error).__name__"
    assert judge(code, "secret = 7\nassert f(lambda: secret) == 'AttributeError'").correct
