"""The tool ``calculate``: arithmetic on text that a model wrote, without ``eval`` and without unbounded time."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from typing import Any

_MAX_CHARACTERS = 2_000
_MAX_BITS = 50_000

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Pow: operator.pow,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {ast.UAdd: operator.pos, ast.USub: operator.neg}


def is_arithmetic(text: str) -> bool:
    """Return whether a text has only digits, points, blanks, parentheses and ``+-*/``."""
    return all(character in "0123456789+-*/(). " for character in text)


def evaluate(expression: str) -> str:
    """Return the value of an expression as Python computes it, rounded to two places.

    Args:
        expression: Arithmetic; ``//`` and ``**`` have their meaning in Python.

    Raises:
        ValueError: The expression or a number in it is too long.
        SyntaxError: It is no expression.
        ArithmeticError: As in Python, such as for a division by zero.
        TypeError: Its value is no real number.
    """
    if not isinstance(expression, str):  # a model may give anything
        raise TypeError("eval() arg 1 must be a string, bytes or code object")
    if len(expression) > _MAX_CHARACTERS:
        raise ValueError(f"the expression is longer than {_MAX_CHARACTERS} characters")
    tree = ast.parse(expression.lstrip(" "), filename="<string>", mode="eval")
    return str(round(float(_value(tree.body)), 2))


def _value(node: ast.expr) -> Any:
    value: Any
    match node:
        case ast.Constant():
            value = node.value
        case ast.UnaryOp():
            value = _UNARY[type(node.op)](_value(node.operand))
        case ast.BinOp():
            left, right = _value(node.left), _value(node.right)
            if isinstance(node.op, ast.Pow):
                _check_power(left, right)
            value = _BINARY[type(node.op)](left, right)
        case ast.Tuple(elts=[]):
            value = ()
        case ast.Call():
            raise TypeError(f"'{type(_value(node.func)).__name__}' object is not callable")
        case _:
            raise ValueError("invalid syntax")
    if isinstance(value, int) and value.bit_length() > _MAX_BITS:
        raise OverflowError("int too large to convert to float")
    return value


def _check_power(base: Any, exponent: Any) -> None:
    if isinstance(base, int) and isinstance(exponent, int) and base.bit_length() * exponent > _MAX_BITS:
        raise OverflowError("int too large to convert to float")
