r"""Computes simple formulas in microseconds, without a parser of all of LaTeX.

Arithmetic of numbers is exact. Formulas with pi, square roots and letters are compared at two points, to 120 digits.
Whatever is not simple, or could be meant in two ways, as 1/2x and f(2), is left to ``gem_math.grading.formulas``.
"""

from __future__ import annotations

import decimal
import re
import zlib
from decimal import Decimal
from fractions import Fraction
from typing import Any

_MAX_CHARS = 200
_MAX_BITS = 60_000
_THOUSANDS = re.compile(r"(?<![\d.,])[1-9]\d{0,2}(?:,\d{3})+(?![\d,])")
_TOKEN = re.compile(r"\s*(?:(\d+\.?\d*|\.\d+)|\\(frac|sqrt|pi|cdot|times|div)(?![a-zA-Z])|([a-zA-Z])|([-+*/^(){}])|\S)")
_OPERATORS = {"cdot": "*", "times": "*", "div": "/"}
_CONTEXT = decimal.Context(prec=120, traps=[decimal.InvalidOperation, decimal.DivisionByZero, decimal.Overflow])
_EQUAL, _UNEQUAL, _TINY = Decimal("1e-90"), Decimal("1e-20"), Decimal("1e-30")
_MAX_DIGITS, _MAX_EXPONENT, _MAX_MAGNITUDE = 12, 50, 25
"""Of formulas that are not computed exactly: others may differ by less than is computed."""
# e and i are numbers, c may be a constant of integration, and d its sign.
_NO_LETTERS = set("cdeiCEI")
_PI = Decimal("3.14159265358979323846" + "5772156649" * 9)
"""Not beyond these digits: nothing that a formula says equals it, but what has it."""
# The tokens of a fraction of digits, the last one first.
_MIXED = re.compile(r"\}\d+\{\}\d+\{frac")
_NOT_SIMPLE = (ValueError, ArithmeticError, IndexError)


def number_of(text: str) -> Fraction | None:
    r"""Return the value of an arithmetic of numbers and fractions, as 2\frac{1}{3}; None of any other text."""
    try:
        return Fraction(_Reader(text, None).formula())
    except _NOT_SIMPLE:
        return None


def same_value(gold: str, answer: str) -> bool | None:
    """Return whether two formulas with pi, square roots and letters are the same; None where that is not told."""
    try:
        with decimal.localcontext(_CONTEXT):
            verdicts = {_alike(_Reader(gold, point).formula(), _Reader(answer, point).formula()) for point in (1, -2)}
    except _NOT_SIMPLE:
        return None
    return False if False in verdicts else None if None in verdicts else True


def _alike(one: Decimal, other: Decimal) -> bool | None:
    difference, size = abs(one - other), max(abs(one), abs(other))
    if size < _TINY:
        return True if size < _EQUAL else None
    return True if difference < size * _EQUAL else False if difference > size * _UNEQUAL else None


class _Reader:
    """Computes a formula while it reads it; raises ValueError, ArithmeticError or IndexError at what is not simple.

    Args:
        text: The formula.
        point: Decides the values of letters; None to read exact numbers alone.
    """

    def __init__(self, text: str, point: int | None) -> None:
        if len(text) > _MAX_CHARS:
            raise ValueError("it is too long")
        self.point = point
        self.letters = 0
        self.tokens: list[str] = []
        for match in _TOKEN.finditer(_THOUSANDS.sub(lambda match: match[0].replace(",", ""), text.strip())):
            if match.lastindex is None:
                raise ValueError(f"{match[0]!r} is not simple")
            self.tokens.append(_OPERATORS.get(match[match.lastindex], match[match.lastindex]))
        self.tokens.reverse()

    def formula(self) -> Any:
        """Return the value of all of it."""
        value = self.sum()
        if self.tokens:
            raise ValueError("a bracket is closed that was not opened")
        return value

    @property
    def following(self) -> str:
        return self.tokens[-1] if self.tokens else ""

    def sign(self) -> int:
        return (-1 if self.tokens.pop() == "-" else 1) if self.following in {"+", "-"} else 1

    def sum(self) -> Any:
        total = self.sign() * self.product()
        while self.following in {"+", "-"}:
            total += self.sign() * self.product()
        return total

    def product(self) -> Any:
        """Read factors, with signs between them or side by side."""
        value, divided = self.factor(), False
        while self.following not in {"", "+", "-", ")", "}"}:
            if self.following in {"*", "/"}:
                divided = self.tokens.pop() == "/"
                factor = self.sign() * self.factor()
                value = value / factor if divided else value * factor
            elif divided or self.following == "{" or self.following[0] in "0123456789.":
                raise ValueError("what stands side by side may be no product")
            else:
                value *= self.factor()
        return value

    def factor(self) -> Any:
        """Read a number, letter, fraction, root or bracket, with its power."""
        letters = self.letters
        base = self.atom()
        if self.following != "^":
            return base
        self.tokens.pop()
        exponent = self.sign() * self.atom()
        if self.following == "^":
            raise ValueError("a power has two exponents")
        if self.point is None:
            bits = max(abs(base.numerator), base.denominator).bit_length()
            if exponent.denominator != 1 or bits * abs(exponent) > _MAX_BITS or (not base and exponent <= 0):
                raise ValueError("this is a root, or too large")
            return Fraction(base ** int(exponent))
        if exponent == Decimal("0.5") and letters == self.letters:
            return base.sqrt()
        if exponent != int(exponent) or abs(exponent) > _MAX_EXPONENT:
            raise ValueError("this is a root, or too large")
        value = base ** int(exponent)
        if value and abs(value.adjusted()) > _MAX_MAGNITUDE:
            raise ValueError("this is too large")
        return value

    def atom(self) -> Any:
        token = self.tokens.pop()
        if token[0] in "0123456789.":
            return self.number(token)
        if token in {"(", "{"}:
            value = self.sum()
            if self.tokens.pop() != {"(": ")", "{": "}"}[token]:
                raise ValueError("the brackets do not match")
            return value
        if token == "frac":
            return self.argument() / self.argument()
        if self.point is None:
            raise ValueError(f"{token} is no number")
        if token == "sqrt":
            letters, value = self.letters, self.argument()
            if letters != self.letters:
                raise ValueError("the root of a letter has two signs")
            return value.sqrt()
        if token == "pi":
            return _PI
        if token in _NO_LETTERS or self.following == "(":
            raise ValueError("this may be a constant or a function")
        self.letters += 1
        return Decimal(zlib.crc32(f"{token}{self.point}".encode())) / self.point / 10**9

    def argument(self) -> Any:
        """Read what a fraction or root is made of: a group or a single digit."""
        if self.following[:1].isdigit():
            digits = self.tokens.pop()
            self.tokens += [digits[1:]] if digits[1:] else []
            return self.number(digits[0])
        if self.following != "{":
            raise ValueError("this is no group")
        return self.atom()

    def number(self, digits: str) -> Any:
        if self.point is not None:
            if len(digits) > _MAX_DIGITS or self.following == "frac":
                raise ValueError("this is too long, or a mixed number")
            return Decimal(digits)
        if self.following != "frac":
            return Fraction(digits)
        if not digits.isdigit() or not _MIXED.fullmatch("".join(self.tokens[-7:])):
            raise ValueError("this is no mixed number")
        return Fraction(digits) + self.atom()
