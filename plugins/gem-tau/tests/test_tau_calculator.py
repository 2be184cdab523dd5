"""``calculate``: the numbers of Python, and nothing else of it."""

from __future__ import annotations

import pytest

from gem_tau.calculator import evaluate, is_arithmetic


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("2 + 2", "4.0"),
        (" -(1.005 - 3) * 2", "3.99"),
        ("7 // 2 + 2**3", "11.0"),
        ("10 / 4 - .5", "2.0"),
        ("1/3", "0.33"),
    ],
)
def test_values_are_rounded_to_two_places(expression: str, expected: str) -> None:
    assert evaluate(expression) == expected


@pytest.mark.parametrize(
    ("expression", "error", "expected"),
    [
        ("1 / 0", ZeroDivisionError, "division by zero"),
        ("(1", SyntaxError, r"'\(' was never closed \(<string>, line 1\)"),
        ("", SyntaxError, r"invalid syntax \(<string>, line 0\)"),
        ("1(2)", TypeError, "'int' object is not callable"),
        ("()", TypeError, "float.. argument must be a string or a real number, not 'tuple'"),
        ("(-8) ** .5", TypeError, "float.. argument must be a string or a real number, not 'complex'"),
    ],
)
def test_errors_are_those_of_python(expression: str, error: type[Exception], expected: str) -> None:
    with pytest.raises(error, match=expected):
        evaluate(expression)


@pytest.mark.parametrize(
    "expression",
    [
        "9**9**9**9",
        "9**99999999999",
        "(9**9999)" + "*(9**9999)" * 100,
        "9**15000*9**15000//9**15000//9**15000",
        "(" * 1_000,
        "-" * 1_999 + "1",
        "1+" * 900_000 + "1",
    ],
)
def test_hostile_expressions_end_soon(expression: str) -> None:
    """What would take for ever, or the whole memory or stack, is refused."""
    with pytest.raises((ValueError, OverflowError, SyntaxError, RecursionError, MemoryError)):
        evaluate(expression)


def test_other_characters_are_no_arithmetic() -> None:
    """Names, commas and underscores would be the way out of it."""
    assert is_arithmetic("(1 + 2.5) * 3 / -4")
    assert not any(is_arithmetic(text) for text in ("a", "1,0", "1_0", "1e5", "[1]", "\n", "٣"))
