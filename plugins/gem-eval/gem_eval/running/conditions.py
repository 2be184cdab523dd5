"""Conditions on the columns of a row, as ``level == 5 and subject != 'Geometry'``: Python's operators, and no more."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.suggestions import did_you_mean

_MOST_CHARS = 1000
_ALLOWED = (
    *(ast.Expression, ast.Load, ast.BoolOp, ast.UnaryOp, ast.Compare, ast.Name, ast.Constant, ast.List, ast.Tuple),
    *(ast.Set, ast.boolop, ast.cmpop, ast.unaryop),
)
"""No calls, attributes, subscripts or arithmetic: what is left can neither reach anything nor take long."""

Condition = Callable[[Mapping[str, Any]], bool]


def parse_condition(text: str) -> Condition:
    """Return the test of a row that a condition stands for.

    It compares columns with values and with each other, and joins comparisons by ``and``, ``or``, ``not`` and
    parentheses, as Python does: ``level == '5'`` where the data set writes a number as text.

    Raises:
        ArgumentError: It is no such condition.
    """
    try:
        if len(text) > _MOST_CHARS:
            raise ValueError("it is too long")
        tree = ast.parse(text.strip(), mode="eval")
        for node in ast.walk(tree):
            if not isinstance(node, _ALLOWED):
                raise ValueError(f"{type(node).__name__} has no place in one")
        code = compile(tree, "--where", "eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else error
        raise ArgumentError(
            f"{text!r:.200} is no condition ({reason}); write it as \"level == 5 and subject != 'Geometry'\""
        ) from None
    columns = [node.id for node in ast.walk(tree) if isinstance(node, ast.Name)]

    def holds(row: Mapping[str, Any]) -> bool:
        for name in columns:
            if name not in row:
                raise ArgumentError(f"there is no column {name!r}.{did_you_mean(name, row)} Columns: {', '.join(row)}")
        try:
            return bool(eval(code, {"__builtins__": {}}, dict(row)))  # only what _ALLOWED lets pass
        except (TypeError, ValueError) as error:
            raise ArgumentError(f"the condition {text!r} does not fit the rows: {error}") from None

    return holds
