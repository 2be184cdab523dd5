r"""Intervals, and the inequalities that describe them."""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from typing import Any

from gem_math.grading_forms import Form, Group, Inequality, Leaf, Union
from gem_math.grading_numbers import exact_value

_DISTANCE = re.compile(r"^\s*\|\s*([A-Za-z])\s*(?:([-+])\s*([^|]+))?\|\s*$")
_BELOW = {">": "<", ">=": "<="}
_TURNED = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}
PLUS_INFINITY, MINUS_INFINITY = Leaf(r"\infty"), Leaf(r"-\infty")
REAL_LINE = Group("(", (MINUS_INFINITY, PLUS_INFINITY), ")")


def half_line(sign: str, bound: Form) -> Form:
    """Return where a number lies that has a sign of comparison, such as ``<=``, before the bound."""
    below = Group("(", (MINUS_INFINITY, bound), ")" if sign != "<=" else "]")
    above = Group("(" if sign != ">=" else "[", (bound, PLUS_INFINITY), ")")
    if sign == "!=":
        return Union((below, above))
    return below if sign in {"<", "<="} else above


def exact_of_leaf(form: Form) -> Any:
    """Return the value of a rational number without a base; None of anything else."""
    return exact_value(form.text) if isinstance(form, Leaf) and form.base is None else None


def distance(sides: list[str], sign: str, read: Callable[[str], Form]) -> Inequality | None:
    r"""Return where x lies if its distance from a is less or greater than b > 0; None of anything else."""
    match = _DISTANCE.match(sides[0])
    if match is None and (match := _DISTANCE.match(sides[1])) is not None:
        sides, sign = sides[::-1], _TURNED.get(sign, sign)
    if match is None or sign not in _TURNED:
        return None
    name, minus, centre = match.groups()
    bound, middle = exact_of_leaf(read(sides[1])), exact_of_leaf(read(centre)) if centre else Fraction(0)
    if bound is None or middle is None or bound <= 0:
        return None
    middle = -middle if minus == "+" else middle
    low, high = Leaf(str(middle - bound)), Leaf(str(middle + bound))
    if sign in {"<", "<="}:
        return Inequality(name, Group("(" if sign == "<" else "[", (low, high), ")" if sign == "<" else "]"))
    return Inequality(name, Union((half_line(_BELOW[sign], low), half_line(sign, high))))


def between(items: list[Form]) -> Form | None:
    """Return the interval that x > 1 and x < 2 describe; of x < 1 and x > 2 there is none."""
    if len(items) != 2:
        return None
    first, second = items
    if not (isinstance(first, Inequality) and isinstance(second, Inequality) and first.name == second.name):
        return None
    if not (isinstance(first.values, Group) and isinstance(second.values, Group)):
        return None
    lower, upper = first.values, second.values
    if lower.items[0] == MINUS_INFINITY:
        lower, upper = upper, lower
    if lower.items[1] != PLUS_INFINITY or upper.items[0] != MINUS_INFINITY:
        return None
    low, high = exact_of_leaf(lower.items[0]), exact_of_leaf(upper.items[1])
    if low is None or high is None or low >= high:
        return None
    return Inequality(first.name, Group(lower.opening, (lower.items[0], upper.items[1]), upper.closing))


def union_of(items: list[Form]) -> Form | None:
    """Return the union that several inequalities of one variable describe."""
    if not items or not all(isinstance(item, Inequality) for item in items):
        return None
    names = {item.name for item in items if isinstance(item, Inequality)}
    if len(names) != 1:
        return None
    parts: list[Form] = []
    for item in items:
        if isinstance(item, Inequality):
            parts.extend(item.values.parts if isinstance(item.values, Union) else [item.values])
    return Inequality(names.pop(), Union(tuple(parts)))
