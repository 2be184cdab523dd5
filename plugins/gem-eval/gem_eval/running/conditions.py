"""Conditions on the columns of a row, as ``level == 5 and subject != 'Geometry'``: Python's words, and no more."""

from __future__ import annotations

import ast
import itertools
import operator
from collections.abc import Callable, Mapping
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean

_MOST_CHARS = 1000
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda value, among: value in among,
    ast.NotIn: lambda value, among: value not in among,
}

Condition = Callable[[Mapping[str, Any]], bool]


def parse_condition(text: str) -> Condition:
    """Return the test of a row that a condition stands for.

    It may compare columns with values and with each other, and join comparisons by ``and``, ``or``, ``not`` and
    parentheses. Where a number is compared with a text that holds one, both are taken as numbers: data sets write
    ``"5"`` as often as ``5``.

    Raises:
        ArgumentError: It is no such condition.
    """
    try:
        if len(text) > _MOST_CHARS:
            raise ValueError("it is too long")
        tree = ast.parse(text.strip(), mode="eval").body
        _check(tree)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else error
        raise ArgumentError(
            f"{text!r:.200} is no condition ({reason}); write it as \"level == 5 and subject != 'Geometry'\""
        ) from None

    def holds(row: Mapping[str, Any]) -> bool:
        try:
            return bool(_value(tree, row))
        except TypeError as error:
            raise ArgumentError(f"the condition {text!r} does not fit the rows: {error}") from None

    return holds


def _check(node: ast.expr) -> None:
    match node:
        case ast.BoolOp(values=parts) | ast.List(elts=parts) | ast.Tuple(elts=parts) | ast.Set(elts=parts):
            each = parts
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            each = [operand]
        case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _COMPARISONS for op in ops):
            each = [left, *others]
        case ast.Name() | ast.Constant():
            each = []
        case _:
            raise ValueError(f"{ast.unparse(node)!r} has no place in one")
    for part in each:
        _check(part)


def _value(node: ast.expr, row: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=value):
            return value
        case ast.Name(id=name):
            if name not in row:
                raise ArgumentError(f"there is no column {name!r}.{did_you_mean(name, row)} Columns: {', '.join(row)}")
            return row[name]
        case ast.BoolOp(op=ast.And(), values=parts):
            return all(_value(part, row) for part in parts)
        case ast.BoolOp(values=parts):
            return any(_value(part, row) for part in parts)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return not _value(operand, row)
        case ast.UnaryOp(operand=operand):
            return -_value(operand, row)
        case ast.List(elts=parts) | ast.Tuple(elts=parts) | ast.Set(elts=parts):
            return [_value(part, row) for part in parts]
        case ast.Compare(left=left, ops=ops, comparators=others):
            values = [_value(part, row) for part in (left, *others)]
            return all(_compare(op, *pair) for op, pair in zip(ops, itertools.pairwise(values), strict=True))
    raise TypeError(f"{ast.unparse(node)!r} has no value")


def _compare(op: ast.cmpop, left: Any, right: Any) -> bool:
    if isinstance(left, str) != isinstance(right, str) and all(
        isinstance(each, str | int | float) for each in (left, right)
    ):
        try:
            left, right = float(left), float(right)
        except ValueError:
            if not isinstance(op, ast.Eq | ast.NotEq):
                raise TypeError(f"{left!r:.50} and {right!r:.50} have no order") from None
    if isinstance(op, ast.In | ast.NotIn) and isinstance(right, list):
        found = any(_compare(ast.Eq(), left, each) for each in right)
        return found is isinstance(op, ast.In)
    return bool(_COMPARISONS[type(op)](left, right))
