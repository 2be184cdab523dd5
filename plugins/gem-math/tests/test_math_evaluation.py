"""Formulas that are compared by evaluation, exactly: as sympy has them, and as math-verify's grammar reads them."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_math import grade
from gem_math.grading import formulas
from gem_math.grading.arithmetic import number_of

NUMBERS = st.fractions(min_value=-50, max_value=50, max_denominator=40)


def spelled(value: Fraction, way: int) -> str:
    """Return a rational number, written in one of several ways."""
    above, below = value.numerator, value.denominator
    ways = [rf"\frac{{{above}}}{{{below}}}", f"{above}/{below}", rf"\dfrac{{{2 * above}}}{{{2 * below}}}"]
    ways.append(rf"{above} \cdot {below}^{{-1}}")
    return ways[way % len(ways)]


def trees() -> st.SearchStrategy[str]:
    """Give formulas of numbers, roots and one letter."""
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


@given(trees())
def test_a_formula_is_itself_in_another_order(formula: str):
    """Whatever is added and taken away again changes nothing; what is added alone does."""
    assert formulas.same(formula, f"1 + ({formula}) - 1")
    assert not formulas.same(formula, f"({formula}) + 1")


@pytest.mark.parametrize(
    ("formula", "value"),
    [
        (r"\frac12", "1/2"),
        (r"\frac1{72}", "1/72"),
        (r"2\frac{1}{3}", "7/3"),
        ("-2^2", "-4"),
        ("2^{3^2}", "512"),
        ("1.50", "3/2"),
        ("007", "7"),
        ("10^{-2}", "1/100"),
        ("8/2/2", "2"),
        (r"3 \cdot (4+5)", "27"),
    ],
)
def test_numbers_are_read_without_a_process(formula: str, value: str):
    """Arithmetic comes out exactly, and sympy's grammar agrees."""
    assert number_of(formula) == Fraction(value)
    assert formulas.value(formula) == Fraction(value)


@pytest.mark.parametrize(
    ("formula", "value"),
    [
        (r"\sqrt{\frac{9}{4}}", "3/2"),
        (r"\sqrt[3]{-8}", "-2"),
        ("5!", "120"),
        (r"\binom{5}{2}", "10"),
        (r"\lfloor -\frac12 \rfloor", "-1"),
        (r"|{-3}|", "3"),
        ("4^{0.5}", "2"),
        ("50\\%", "1/2"),
        ("2(3)", "6"),
        ("(2)(3)", "6"),
        ("3(4+5)", "27"),
        (r"1/2 \cdot 3", "3/2"),
        ("i^2", "-1"),
        ("2^(1+2)", "8"),
    ],
)
def test_values_of_formulas(formula: str, value: str):
    """Where the grammar alone would read something else, it is given what is meant."""
    assert formulas.value(formula) == Fraction(value)


@pytest.mark.parametrize(
    "text", ["", "1 +", "2 3", ")", "1..2", "x^", "a & b", "1,2", "=", "((1)", "1{2}", "x'", "-" * 40]
)
def test_what_is_no_number_is_not_read(text: str):
    """Nothing is read in part."""
    assert number_of(text) is None
    assert formulas.value(text) is None


@pytest.mark.parametrize("text", ["9^{9^{9}}", "9^{9^{9^{9}}}", "10^{100000}", "0.5^{10^{9}}", "9" * 300])
def test_what_would_take_long_is_no_number_here(text: str):
    """It is left to a process, which can be ended."""
    assert number_of(text) is None


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (r"10^{50}+\pi", r"10^{50}+\pi+10^{-50}"),
        (r"10^{100}\pi", r"10^{100}\pi+1"),
        ("2^{20000}+1", "2^{20000}"),
        (r"\pi \cdot 10^{-100}", "0"),
        ("1/10^{400}", "0"),
        (r"10^{100}x+y", r"10^{100}x"),
        ("x^2+10^{-17}", "x^2"),
    ],
)
def test_a_difference_is_never_rounded_away(one: str, other: str):
    """Numbers that differ by less than floats show are not taken for the same."""
    assert not formulas.same(one, other)
