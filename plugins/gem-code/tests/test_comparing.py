"""How outputs and values are compared."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_code.comparing import same_output, same_value


@pytest.mark.parametrize(
    ("printed", "expected", "right"),
    [
        ("1 2  \n\n\n", "1 2\n", True), ("\n1 2\n", "1 2\n", True), ("1 2\r\n3\r\n", "1 2\n3", True),
        ("1  2\n", "1 2\n", False), ("1\n2\n", "1 2\n", False), ("1\n\n2\n", "1\n2\n", False), ("  1\n2", "1\n2", True),
        ("1\n  2", "1\n2", False), ("12", "1 2", False), ("", "\n", True), ("", "0", False), ("yes", "YES", False),
        ("1.0", "1", False), ("0012", "12", False),
    ],
)  # fmt: skip
def test_output_is_compared_as_contests_do(printed: str, expected: str, right: bool) -> None:
    """White space at the ends does not count."""
    assert same_output(printed, expected) is right


@pytest.mark.parametrize(
    ("printed", "expected", "right"),
    [
        ("0.333333", "0.3333333333", True), ("0.3333", "0.3333333333", False), ("1000000.5", "1000000.0", True),
        ("1000002.5", "1000000.0", False), ("1e-7", "0", True), ("x 1.0000001", "x 1.0", True),
        ("y 1.0", "x 1.0", False), ("3", "3.0", True), ("3", "4", False), ("1000001", "1000000", False),
        ("1.0 2.0", "1.0", False), ("10000000000000000001", "10000000000000000000", False), ("nan", "nan", True),
        ("nan", "1.0", False),
        ("inf", "1.0", False), ("1_0.0", "10.0", False), ("١.0", "1.0", False), ("", "0.0", False),
    ],
)  # fmt: skip
def test_tolerance_is_absolute_or_relative(printed: str, expected: str, right: bool) -> None:
    """Of 1e-6, word by word; whole numbers are compared exactly, and what is no number of a contest is none."""
    assert same_output(printed, expected, float_tolerance=1e-6) is right


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(-1, 1))
def test_within_tolerance_is_the_same_on_both_sides(number: float, shift: float) -> None:
    """A number that is off by half the tolerance passes, by twice it does not."""
    scale = max(1.0, abs(number))
    if not math.isfinite(number + 4 * scale * 1e-3):
        return
    assert same_output(repr(number + shift * scale * 0.5e-3), repr(number), float_tolerance=1e-3)
    assert not same_output(repr(number + scale * 2e-3), repr(number), float_tolerance=1e-3)


@pytest.mark.parametrize(
    ("returned", "expected", "right"),
    [
        ((1, 2), [1, 2], True), ([(1,), (2,)], [[1], [2]], True), ([1, 2], [2, 1], False), ([1], [1, 1], False),
        ({1: "a"}, {"1": "a"}, True), ({"a": 1}, {"a": 2}, False), (1, 1.0, True), (True, 1, False), (1, True, False),
        (False, False, True), (None, None, True), (0, None, False), ("1", 1, False), (10**400, 1.5, False),
    ],
)  # fmt: skip
def test_values_are_compared_as_json_has_them(returned: object, expected: object, right: bool) -> None:
    """Tuples are lists there, and keys are text; truth values are no numbers."""
    assert same_value(returned, expected) is right
    assert same_value(returned, expected, 1e-9) is right


def test_values_within_a_tolerance() -> None:
    """Inside of lists too, and only for floats."""
    assert same_value([0.1 + 0.2], [0.3], 1e-9)
    assert not same_value([0.1 + 0.2], [0.3])
    assert not same_value(3, 4, 10.0)
