r"""Evaluates a formula at a point: numbers exactly, the rest to 120 digits, each letter at a value of its own.

The evaluation has bounds on size throughout, so that no formula takes more than milliseconds.
"""

from __future__ import annotations

import math
import threading
import zlib
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import mpmath  # type: ignore[import-untyped]  # it has no types

from gem_math.grading_formulas import Formula, Tree, UnsupportedError

POINTS = 4
"""The points from here on are far away."""
EQUAL, UNEQUAL = mpmath.mpf(10) ** -75, mpmath.mpf(10) ** -45
"""What differs by less is the same, and what differs by more is not; between these nothing is told."""
_DIGITS = 120
# Below and above these, floats of 120 digits could hide a difference behind a cancellation.
_SMALL, _LARGE = mpmath.mpf(10) ** -35, mpmath.mpf(10) ** 35
_LEAST = Fraction(1, 10**35)
_MAX_BITS = 60_000
_MAX_WORK = 2_000_000  # bits of all exact results together

Value = Any  # Fraction, mpf or mpc


class UndefinedError(Exception):
    """The formula has no value at this point."""


class _Local(threading.local):
    """A context of mpmath for each thread: its functions change the precision of theirs for a moment."""

    def __init__(self) -> None:
        self.context = mpmath.MPContext()
        self.context.dps = _DIGITS


_LOCAL = _Local()


class _Run:
    """What one evaluation keeps."""

    __slots__ = ("base", "context", "point", "whole", "work")

    def __init__(self, point: int, base: str, whole: bool) -> None:
        self.context = _LOCAL.context
        self.point = point
        self.base = base
        self.whole = whole
        self.work = 0


def evaluate(formula: Formula, point: int, base: str, whole: bool) -> Value:
    """Return the value of a formula at one of the points.

    Args:
        formula: The formula.
        point: Number of the point, from 0.
        base: Base of logarithms without one: "e" or "10".
        whole: Give the letters whole numbers.

    Raises:
        UndefinedError: It has no value there.
        UnsupportedError: It takes too much, or its digits would not tell.
    """
    return _value(formula.tree, _Run(point, base, whole))


def _value(tree: Tree, run: _Run) -> Value:
    kind = tree[0]
    if kind == "n":
        return tree[1]
    if kind == "x":
        return _letter_value(tree[1], run)
    if kind in {"pi", "e"}:
        return +run.context.pi if kind == "pi" else +run.context.e
    if kind == "i":
        return run.context.mpc(0, 1)
    values = [_value(part, run) for part in tree[1:] if part is not None]
    return _checked(_OPERATIONS[kind](values, run), run)


def _letter_value(name: str, run: _Run) -> Fraction:
    """A value that depends on the name and the point alone: positive, negative, large, small; or a whole number."""
    seed = zlib.crc32(f"{name}#{run.point}".encode())
    if run.whole:
        return Fraction(3 + (seed % 29) * 2 + run.point % 2 + (run.point // POINTS) * (seed >> 8) % 5)
    if run.point >= POINTS:
        far = Fraction((30 + seed % 37) * 20 ** ((run.point - POINTS) // 2))
        return -far if run.point % 2 else far
    number = Fraction(101 + seed % 7919, 1009 + (seed >> 13) % 3001)
    return -number if run.point == 1 else (number + 3 if run.point == 2 else number)


def _checked(value: Value, run: _Run) -> Value:
    if isinstance(value, Fraction):
        bits = value.numerator.bit_length() + value.denominator.bit_length()
        run.work += bits
        if bits > _MAX_BITS or run.work > _MAX_WORK:
            raise UnsupportedError
        return value
    if not run.context.isfinite(value):
        raise UndefinedError
    if abs(value) > _LARGE:
        raise UnsupportedError
    return value


def as_float(value: Value) -> Value:
    """Return a value as a float of 120 digits.

    Raises:
        UnsupportedError: It is too large or too small for that to tell it from others.
    """
    if not isinstance(value, Fraction):
        return value
    context = _LOCAL.context
    # Beyond these sizes two numbers may differ by less than 120 digits show.
    if value and not _LEAST < abs(value) < 1 / _LEAST:
        raise UnsupportedError
    return context.mpf(value.numerator) / value.denominator


def is_zero(value: Value) -> bool:
    """Return whether a value is zero, as far as 120 digits tell."""
    return value == 0 if isinstance(value, Fraction) else abs(value) < EQUAL


def _add(values: list[Value], run: _Run) -> Value:
    total = values[0]
    for value in values[1:]:
        exact = isinstance(total, Fraction) and isinstance(value, Fraction)
        total = total + value if exact else as_float(total) + as_float(value)
    return total


def _multiply(values: list[Value], run: _Run) -> Value:
    one, other = values
    if isinstance(one, Fraction) and isinstance(other, Fraction):
        return one * other
    product = as_float(one) * as_float(other)
    if not is_zero(one) and not is_zero(other) and abs(product) < _SMALL:
        raise UnsupportedError
    return product


def divide(one: Value, other: Value) -> Value:
    """Return the quotient of two values.

    Raises:
        UndefinedError: The second is zero.
        UnsupportedError: The quotient is too small to tell.
    """
    if is_zero(other):
        raise UndefinedError
    if isinstance(one, Fraction) and isinstance(other, Fraction):
        return one / other
    quotient = as_float(one) / as_float(other)
    if not is_zero(one) and abs(quotient) < _SMALL:
        raise UnsupportedError
    return quotient


def _power(values: list[Value], run: _Run) -> Value:
    base, exponent = values
    if isinstance(base, Fraction) and isinstance(exponent, Fraction):
        exact = _exact_power(base, exponent)
        if exact is not None:
            return exact
    if is_zero(base):
        raise UndefinedError
    base, exponent = as_float(base), as_float(exponent)
    if abs(exponent * run.context.log(abs(base))) > 80:
        raise UnsupportedError
    return run.context.power(base, exponent)


def _exact_power(base: Fraction, exponent: Fraction) -> Fraction | None:
    if exponent.denominator == 1:
        power = exponent.numerator
        if base == 0:
            if power <= 0:
                raise UndefinedError
            return base
        if abs(base) == 1:
            return base if power % 2 else Fraction(1)
        size = max(abs(base.numerator), base.denominator).bit_length()
        if size * abs(power) > _MAX_BITS:
            raise UnsupportedError
        return base**power
    if exponent.denominator <= 64 and base >= 0:
        root = _exact_root(base, exponent.denominator)
        if root is not None:
            return _exact_power(root, Fraction(exponent.numerator))
    return None


def _exact_root(value: Fraction, index: int) -> Fraction | None:
    top, bottom = _whole_root(value.numerator, index), _whole_root(value.denominator, index)
    return None if top is None or bottom is None else Fraction(top, bottom)


def _whole_root(value: int, index: int) -> int | None:
    if index == 2:
        root = math.isqrt(value)
    elif value.bit_length() > 2000:
        return None
    else:
        root = round(value ** (1 / index)) if value.bit_length() < 1000 else 0
    return next((near for near in (root - 1, root, root + 1) if near >= 0 and near**index == value), None)


def _root_of(values: list[Value], run: _Run) -> Value:
    value, index = values
    if not isinstance(index, Fraction) or index.denominator != 1 or not 1 < index <= 64:
        raise UnsupportedError
    whole = int(index)
    if isinstance(value, Fraction):
        exact = _exact_root(abs(value), whole)
        if exact is not None and (value >= 0 or whole % 2):
            return exact if value >= 0 else -exact
    number = as_float(value)
    if whole % 2 and not isinstance(number, run.context.mpc) and number < 0:
        return -run.context.root(-number, whole)
    return run.context.sqrt(number) if whole == 2 else run.context.root(number, whole)


def _factorial(values: list[Value], run: _Run) -> Value:
    (value,) = values
    if not isinstance(value, Fraction) or value.denominator != 1 or value > 3000:
        raise UnsupportedError
    if value < 0:
        raise UndefinedError
    return Fraction(math.factorial(int(value)))


def _binomial(values: list[Value], run: _Run) -> Value:
    above, below = values
    for value in values:
        if not isinstance(value, Fraction) or value.denominator != 1 or abs(value) > 3000:
            raise UnsupportedError
    if above < 0 or below < 0:
        raise UndefinedError
    return Fraction(math.comb(int(above), int(below)))


def _whole_part(up: bool) -> Callable[[list[Value], _Run], Value]:
    def round_off(values: list[Value], run: _Run) -> Value:
        (value,) = values
        if isinstance(value, Fraction):
            return Fraction(math.ceil(value) if up else math.floor(value))
        if isinstance(value, run.context.mpc) or abs(value - run.context.nint(value)) < UNEQUAL:
            raise UnsupportedError
        return Fraction(int(run.context.ceil(value) if up else run.context.floor(value)))

    return round_off


def _logarithm(values: list[Value], run: _Run) -> Value:
    if is_zero(values[0]):
        raise UndefinedError
    if len(values) == 1:
        base = run.context.mpf(10) if run.base == "10" else None
    else:
        base = as_float(values[1])
        if is_zero(base) or is_zero(base - 1):
            raise UndefinedError
    logarithm = run.context.log(as_float(values[0]))
    return logarithm if base is None else logarithm / run.context.log(base)


def _absolute(values: list[Value], run: _Run) -> Value:
    return abs(values[0])


def _named(name: str) -> Callable[[list[Value], _Run], Value]:
    def apply(values: list[Value], run: _Run) -> Value:
        value = as_float(values[0])
        if abs(value) > (80 if name in {"exp", "sinh", "cosh", "tanh"} else 10**12):
            raise UnsupportedError
        try:
            return getattr(run.context, name)(value)
        except (ZeroDivisionError, ValueError) as error:
            raise UndefinedError from error

    return apply


_OPERATIONS: dict[str, Callable[[list[Value], _Run], Value]] = {
    "+": _add,
    "-": lambda values, run: -values[0],
    "*": _multiply,
    "/": lambda values, run: divide(*values),
    "^": _power,
    "root": _root_of,
    "!": _factorial,
    "binom": _binomial,
    "floor": _whole_part(up=False),
    "ceil": _whole_part(up=True),
    "abs": _absolute,
    "log": _logarithm,
    "ln": lambda values, run: _logarithm([*values, +run.context.e], run),
    "exp": _named("exp"),
    "sin": _named("sin"),
    "cos": _named("cos"),
    "tan": _named("tan"),
    "cot": _named("cot"),
    "sec": _named("sec"),
    "csc": _named("csc"),
    "arcsin": _named("asin"),
    "arccos": _named("acos"),
    "arctan": _named("atan"),
    "sinh": _named("sinh"),
    "cosh": _named("cosh"),
    "tanh": _named("tanh"),
}
