"""Formulas that are compared by evaluation: exactly, with bounds, and with the verdicts of math-verify."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gem_math import grade
from gem_math.grading_formulas import read_formula
from gem_math.grading_numbers import compare_formulas, exact_value
from gem_math.grading_pool import shared_pool

SMALL = st.integers(-30, 30)
NUMBERS = st.fractions(min_value=-50, max_value=50, max_denominator=40)


def spelled(value: Fraction, way: int) -> str:
    """Return a rational number, written in one of several ways."""
    above, below = value.numerator, value.denominator
    ways = [rf"\frac{{{above}}}{{{below}}}", f"{above}/{below}", rf"\dfrac{{{2 * above}}}{{{2 * below}}}"]
    ways.append(rf"{above} \cdot {below}^{{-1}}")
    return ways[way % len(ways)]


def formulas() -> st.SearchStrategy[str]:
    """Give formulas of numbers, roots and one letter that math-verify reads as well."""
    leaves = st.one_of(st.integers(1, 9).map(str), st.sampled_from(["x", r"\pi", r"\sqrt{2}", r"\frac{1}{2}"]))
    return st.recursive(
        leaves,
        lambda parts: st.one_of(
            st.tuples(parts, parts).map(lambda pair: f"({pair[0]} + {pair[1]})"),
            st.tuples(parts, parts).map(lambda pair: f"({pair[0]} - {pair[1]})"),
            st.tuples(parts, parts).map(lambda pair: rf"{pair[0]} \cdot {pair[1]}"),
            st.tuples(parts, st.integers(2, 3)).map(lambda pair: f"({pair[0]})^{{{pair[1]}}}"),
        ),
        max_leaves=4,
    )


@given(NUMBERS, NUMBERS, st.integers(0, 3), st.integers(0, 3))
def test_rational_numbers_are_compared_exactly(one: Fraction, other: Fraction, way: int, other_way: int):
    """However they are written, two numbers are the same if and only if they are."""
    assert grade(f"\\boxed{{{spelled(other, other_way)}}}", spelled(one, way)).correct is (one == other)
    assert grade(f"\\boxed{{{spelled(one, other_way)}}}", spelled(one, way)).correct


@given(formulas(), formulas())
@pytest.mark.thorough
def test_evaluation_agrees_with_math_verify(one: str, other: str):
    """Where evaluation has a verdict, the one of math-verify is the same."""
    first, second = read_formula(one), read_formula(other)
    assert first is not None
    assert second is not None
    verdict = compare_formulas(first, second)
    asked = shared_pool().compare(one, other, 30)
    assert verdict is None or asked.reason or verdict is asked.same


@given(formulas())
@example("((\\pi - \\pi))^{2}")
def test_a_formula_is_itself_in_another_order(formula: str):
    """Whatever is added and taken away again changes nothing; what is added alone does.

    Where all digits cancel, as in the square of pi - pi, evaluation leaves the verdict to math-verify.
    """
    assert verdict_on(f"1 + ({formula}) - 1", formula) is True
    assert verdict_on(f"({formula}) + 1", formula) is False


def verdict_on(answer: str, gold: str) -> bool | None:
    """Return what evaluation says of two formulas, or where it says nothing, what math-verify does."""
    first, second = read_formula(gold), read_formula(answer)
    assert first is not None
    assert second is not None
    verdict = compare_formulas(first, second)
    return shared_pool().compare(gold, answer, 30).same if verdict is None else verdict


@pytest.mark.parametrize(
    ("formula", "value"),
    [
        (r"\frac12", "1/2"),
        (r"\frac1{72}", "1/72"),
        (r"2\frac{1}{3}", "7/3"),
        ("-2^2", "-4"),
        ("2^{3^2}", "512"),
        ("1.50", "3/2"),
        (r"\sqrt{\frac{9}{4}}", "3/2"),
        (r"\sqrt[3]{-8}", "-2"),
        ("5!", "120"),
        (r"\binom{5}{2}", "10"),
        (r"\lfloor -\frac12 \rfloor", "-1"),
        (r"|{-3}|", "3"),
        ("4^{0.5}", "2"),
        ("50\\%", "1/2"),
        ("10^{-2}", "1/100"),
        ("3(4+5)", "27"),
        ("8/2/2", "2"),
    ],
)
def test_values(formula: str, value: str):
    """Rational values come out exactly."""
    assert exact_value(formula) == Fraction(value)


@pytest.mark.parametrize(
    "formula",
    ["", "1 +", "2 3", ")", "1..2", r"\frac{1}", "x^", r"\sum 1", "a & b", r"\text{a}", "1,2", "=", "é", "((1)"],
)
def test_what_is_no_formula_is_not_read(formula: str):
    """Nothing is read in part."""
    assert read_formula(formula) is None


@pytest.mark.parametrize(
    "formula", ["9^{9^{9}}", "9^{9^{9^{9}}}", "((10!)!)!", "10^{100000}", r"\exp(\exp(100))", "0.5^{10^{9}}"]
)
def test_what_would_take_long_is_not_evaluated(formula: str):
    """There is no verdict, at once."""
    read, one = read_formula(formula), read_formula("1")
    assert read is not None
    assert one is not None
    assert compare_formulas(read, one) is None


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (r"10^{50}+\pi", r"10^{50}+\pi+10^{-50}"),
        (r"10^{100}\pi", r"10^{100}\pi+1"),
        ("2^{20000}+1", "2^{20000}"),
        (r"\pi \cdot 10^{-100}", "0"),
        ("1/10^{400}", "0"),
    ],
)
def test_a_difference_is_never_rounded_away(one: str, other: str):
    """Numbers that differ by less than floats show are not taken for the same."""
    first, second = read_formula(one), read_formula(other)
    assert first is not None
    assert second is not None
    assert compare_formulas(first, second) is not True
