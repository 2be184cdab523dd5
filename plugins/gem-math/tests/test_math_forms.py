"""Properties of the forms of answers: what may be written otherwise, and what a small change makes wrong."""

from __future__ import annotations

from fractions import Fraction

from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gem_math import grade
from gem_math.grading.extraction import boxes_of
from gem_math.grading.structure import read
from gem_math.grading.text import clean

numbers = st.integers(-9, 9)
factors = st.fractions(Fraction(1, 9), 9, max_denominator=9).filter(lambda factor: factor != 1)


def right(answer: str, gold: str) -> bool:
    """Return the verdict on an answer in a box."""
    return grade(rf"\boxed{{{answer}}}", gold, timeout_s=20).correct


@settings(max_examples=8)
@given(st.integers(0, 11), st.integers(1, 6), numbers, st.sampled_from("nm"))
def test_a_whole_number_may_be_shifted_and_renamed(start: int, step: int, shift: int, letter: str) -> None:
    """A + pk takes the values of a + mp + pn, and of no other start."""
    gold = rf"x=\frac{{{start}\pi}}{{12}}+\frac{{{step}\pi}}{{2}}k, k\in\mathbb{{Z}}"
    moved = start + 6 * step * shift
    assert right(rf"x=\frac{{{moved}\pi}}{{12}}+\frac{{{step}\pi}}{{2}}{letter}, {letter}\in\mathbb{{Z}}", gold)
    assert right(rf"\frac{{{moved}\pi}}{{12}}-\frac{{{step}\pi}}{{2}}{letter}", gold)
    assert not right(rf"x=\frac{{{moved + 1}\pi}}{{12}}+\frac{{{step}\pi}}{{2}}{letter}, {letter}\in\mathbb{{Z}}", gold)
    assert not right(rf"x=\frac{{{moved}\pi}}{{12}}+\frac{{{step}\pi}}{{4}}{letter}, {letter}\in\mathbb{{Z}}", gold)
    assert not right(rf"x=\frac{{{moved}\pi}}{{12}}+\frac{{{step}\pi}}{{2}}{letter}, {letter}\in\mathbb{{N}}", gold)
    assert not right(rf"x=\frac{{{moved}\pi}}{{12}}", gold)


@settings(max_examples=8)
@given(numbers, numbers, numbers, factors, st.sampled_from(["<", r"\le", ">", r"\ge"]))
def test_an_inequality_may_be_multiplied_and_turned(a: int, b: int, c: int, factor: Fraction, sign: str) -> None:
    """By a positive number as it is, by a negative one only when it is turned; strict and not strict are two."""
    assume(a and b and (a, b) != (-a, -b))
    turned = {"<": ">", ">": "<", r"\le": r"\ge", r"\ge": r"\le"}[sign]
    other = {"<": r"\le", ">": r"\ge", r"\le": "<", r"\ge": ">"}[sign]
    gold = f"{a}x+({b})y {sign} {c}"
    p, q, r = a * factor, b * factor, c * factor
    assert right(f"({p})x+({q})y {sign} {r}", gold)
    assert right(f"({-p})x+({-q})y {turned} {-r}", gold)
    assert right(f"{r} {turned} ({p})x+({q})y", gold)
    assert not right(f"({-p})x+({-q})y {sign} {-r}", gold)
    assert not right(f"({p})x+({q})y {other} {r}", gold)
    assert not right(f"({p})x+({q})y {sign} {r + 1}", gold)


@given(st.text(r"\{}()[],;|&=<0179kxZ.if ", max_size=40))
def test_any_text_is_read(text: str) -> None:
    """Reading takes any text, and boxes around it are found or not, without an exception."""
    read(clean(text))
    boxes = boxes_of(rf"so \boxed{{{text}}} and then \boxed{{1}}")
    assert boxes.sentence is None or boxes.sentence.endswith("1")
