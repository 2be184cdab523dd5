r"""Compares inequalities that are written differently: 2x < 4 and x < 2, 2x + 3y \ge 7 and 4x + 6y \ge 14."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from gem_math.grading_forms import Form, Group, Inequality, Leaf, Opaque
from gem_math.grading_formulas import Formula, read_formula
from gem_math.grading_numbers import positive_multiples
from gem_math.grading_tokens import UnreadableError, sides_of

_MAX_SIDES = 4


class _Condition(NamedTuple):
    """A formula that is greater than zero, or not less."""

    formula: Formula
    strict: bool


def same_region(gold: Form, answer: Form) -> bool | None:
    """Return whether two inequalities, or chains of them, say the same; None where that is not told.

    Each says that some formulas are greater than zero, and two such formulas say the same where one is a positive
    multiple of the other.
    """
    ours, theirs = _conditions(gold, answer), _conditions(answer, gold)
    if ours is None or theirs is None or len(ours) != len(theirs):
        return None
    left = list(theirs)
    for condition in ours:
        verdicts = [
            condition.strict == other.strict and positive_multiples(condition.formula, other.formula) for other in left
        ]
        if True not in verdicts:
            return None if None in verdicts else False
        del left[verdicts.index(True)]
    return True


def _conditions(form: Form, other: Form) -> list[_Condition] | None:
    if isinstance(form, Group) and len(form.items) == 2 and isinstance(other, Opaque):
        # The letter of an interval is the only one of the inequality.
        letters = {letter for condition in _conditions(other, other) or () for letter in condition.formula.letters}
        return _from_interval(letters.pop(), form) if len(letters) == 1 else None
    if isinstance(form, Inequality) and isinstance(form.values, Group):
        return _from_interval(form.name, form.values)
    return _from_text(form.text) if isinstance(form, Opaque) else None


def _from_text(text: str) -> list[_Condition] | None:
    try:
        sides, signs = sides_of(text)
    except UnreadableError:
        return None
    if not signs or len(sides) > _MAX_SIDES or not set(signs) <= {"<", ">", "<=", ">="}:
        return None
    pairs = [pair if sign[0] == ">" else pair[::-1] for pair, sign in zip(pairwise(sides), signs, strict=True)]
    return _read([(*pair, len(sign) == 1) for pair, sign in zip(pairs, signs, strict=True)])


def _from_interval(name: str, interval: Group) -> list[_Condition] | None:
    low, high = interval.items
    if not (isinstance(low, Leaf) and isinstance(high, Leaf)):
        return None
    found = []
    if "infty" not in low.text:
        found.append((name, low.text, interval.opening == "("))
    if "infty" not in high.text:
        found.append((high.text, name, interval.closing == ")"))
    return _read(found)


def _read(differences: list[tuple[str, str, bool]]) -> list[_Condition] | None:
    conditions = []
    for greater, less, strict in differences:
        formula = read_formula(f"({greater})-({less})")
        if formula is None or not formula.letters:
            return None
        conditions.append(_Condition(formula, strict))
    return conditions or None
