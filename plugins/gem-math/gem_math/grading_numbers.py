r"""Compares two formulas by their values.

Two formulas that agree at every point are the same; two that differ at every point are not; between these, and for what
cannot be evaluated (sums, integrals, infinity), the answer is None, and math-verify decides.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from gem_math.grading_evaluation import (
    EQUAL,
    POINTS,
    UNEQUAL,
    UndefinedError,
    Value,
    as_float,
    divide,
    evaluate,
    is_zero,
)
from gem_math.grading_formulas import Formula, Tree, UnsupportedError, read_formula

# Absolute values and roots may agree with something else nearby, floors with something else at some whole numbers.
_POINTS_FAR, _POINTS_WHOLE = range(POINTS, POINTS + 6), range(POINTS, POINTS + 60)
# The letters are negative at the point 1, and at every other one of the far ones.
_POINTS_POSITIVE = [range(0, 1), *(range(point, point + 1) for point in range(2, POINTS)), range(POINTS, POINTS + 1)]
_BROKEN = {"abs", "root", "^", "floor", "ceil", "arcsin", "arccos", "arctan", "log", "ln"}


def compare_formulas(first: Formula, second: Formula) -> bool | None:
    """Return whether two formulas are the same, or None where evaluation does not tell."""
    bases = ("e", "10") if first.ambiguous_log or second.ambiguous_log else ("e",)
    verdicts = [_compare(first, second, base) for base in bases]
    if True in verdicts:
        return True
    return None if None in verdicts else False


def positive_multiples(first: Formula, second: Formula) -> bool | None:
    """Return whether one formula is the other times a positive constant; None where that is not told."""
    verdict = proportional(first, second)
    if not verdict:
        return verdict
    whole = first.whole or second.whole
    for point in range(POINTS):
        try:
            ratio = divide(evaluate(first, point, "e", whole), evaluate(second, point, "e", whole))
        except UndefinedError:
            continue
        return None if ratio.imag else bool(ratio > 0)
    return None


def proportional(first: Formula, second: Formula) -> bool | None:
    """Return whether two formulas differ only by a constant factor that is not zero; None where that is not told."""
    ratios: list[Value] = []
    for point in range(POINTS):
        try:
            one, other = (
                evaluate(first, point, "e", first.whole or second.whole),
                evaluate(second, point, "e", first.whole or second.whole),
            )
            if is_zero(one) or is_zero(other):
                return False if is_zero(one) != is_zero(other) else None
            ratios.append(divide(one, other))
        except UndefinedError:
            continue
        except UnsupportedError:
            return None
    if len(ratios) < 2:
        return None
    verdicts = [_same(ratios[0], ratio) for ratio in ratios[1:]]
    return True if all(verdicts) else (None if None in verdicts else False)


def value_of(formula: Formula) -> Value | None:
    """Return the value of a formula without letters; None where it has letters, or no value."""
    if formula.letters:
        return None
    try:
        return evaluate(formula, 0, "e", False)
    except (UnsupportedError, UndefinedError):
        return None


def exact_value(text: str) -> Fraction | None:
    """Return the value of a formula that is a rational number, exactly; None of any other."""
    formula = read_formula(text)
    value = None if formula is None else value_of(formula)
    return value if isinstance(value, Fraction) else None


def _compare(first: Formula, second: Formula, base: str) -> bool | None:
    letters = first.letters | second.letters
    whole = first.whole or second.whole
    verdicts = _verdicts(first, second, base, whole, range(POINTS if letters else 1))
    if UnsupportedError in verdicts or (len(verdicts) < 2 if letters else not verdicts):
        return None
    if letters and False not in verdicts:
        verdicts += _verdicts_elsewhere(first, second, base, whole)
    if len(set(verdicts)) != 1 and _are_logarithms(first, second):
        verdicts = [verdict for point in _POINTS_POSITIVE for verdict in _verdicts(first, second, base, whole, point)]
        return True if verdicts and set(verdicts) == {True} else None
    return verdicts[0] if len(set(verdicts)) == 1 else None


def _are_logarithms(first: Formula, second: Formula) -> bool:
    """Whether both have logarithms, and neither an absolute value, so that their letters are meant to be positive."""
    kinds = [_kinds(formula.tree) for formula in (first, second)]
    return all(one & {"log", "ln"} and not one & {"abs", "floor", "ceil"} for one in kinds)


def _verdicts(first: Formula, second: Formula, base: str, whole: bool, points: range) -> list[Any]:
    """Return what each point tells where both have a value; ``UnsupportedError`` ends it."""
    verdicts: list[Any] = []
    for point in points:
        try:
            verdicts.append(_same(evaluate(first, point, base, whole), evaluate(second, point, base, whole)))
        except UndefinedError:
            continue
        except (UnsupportedError, RecursionError):
            verdicts.append(UnsupportedError)
            break
    return verdicts


def _verdicts_elsewhere(first: Formula, second: Formula, base: str, whole: bool) -> list[bool | None]:
    """Look at more points where the formulas have pieces, which may agree at some points by chance."""
    kinds = _kinds(first.tree) | _kinds(second.tree)
    found: list[Any] = []
    if kinds & {"floor", "ceil"}:
        found += _verdicts(first, second, base, True, _POINTS_WHOLE)
        # The floor of what is whole at each whole number only says something between them.
        if not kinds & {"!", "binom"} and (_idle(first.tree) or _idle(second.tree)):
            found += _verdicts(first, second, base, False, range(POINTS))
    elif kinds & _BROKEN and not whole:
        for point in _POINTS_FAR:
            found += _verdicts(first, second, base, False, range(point, point + 1))
    return [verdict for verdict in found if verdict is not UnsupportedError]


def _kinds(tree: Tree) -> set[str]:
    """Return the kinds of all parts of a formula; a whole power is a product, and has no pieces."""
    whole = tree[0] == "^" and tree[2][0] == "n" and tree[2][1].denominator == 1
    kinds = {"*" if whole else tree[0]}
    for part in tree[1:]:
        if isinstance(part, tuple):
            kinds |= _kinds(part)
    return kinds


def _idle(tree: Tree) -> bool:
    """Whether a formula has a floor of sums and products of letters and whole numbers."""
    parts = [part for part in tree[1:] if isinstance(part, tuple)]
    if tree[0] in {"floor", "ceil"} and _kinds(tree[1]) <= {"+", "-", "*", "n", "x"} and _kinds(tree[1]) & {"x"}:
        return all(number.denominator == 1 for number in _numbers(tree))
    return any(map(_idle, parts))


def _numbers(tree: Tree) -> list[Fraction]:
    """Return the numbers that are written in a formula."""
    if tree[0] == "n":
        return [tree[1]]
    return [number for part in tree[1:] if isinstance(part, tuple) for number in _numbers(part)]


def _same(one: Value, other: Value) -> bool | None:
    if isinstance(one, Fraction) and isinstance(other, Fraction):
        return one == other
    one, other = as_float(one), as_float(other)
    scale = max(1, abs(one), abs(other))
    difference = abs(one - other) / scale
    if difference < EQUAL:
        return True
    # Where both are small, a difference must be seen beside them, not beside 1.
    return False if difference > UNEQUAL else None
