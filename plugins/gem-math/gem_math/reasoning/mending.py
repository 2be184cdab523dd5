"""What of reasoning-gym 0.1.25 must not run as it is, put right in the process that runs it.

- Nine scorers hand the answer to ``eval``, or to sympy's ``parse_expr``, which calls it: an answer could run code. They
  get readers of their own, for literals and for formulas, that run nothing.
- The scorers of integrals simplify the difference to the integrand, which takes minutes for some answers: where it has
  a value other than 0 somewhere, it is not simplified, since it is not 0.
- Four scorers give 1 to answers that are wrong, as ``gem audit`` found: ``game_of_life_halting`` to any answer,
  ``puzzle24`` to 24 made of other numbers than those given, ``complex_arithmetic`` to ``nan``, and ``coin_flip`` to
  ``0``, as the beginning of every probability. They get what their questions say.
- ``codeio`` keeps its problems in its class, so that of two data sets of different difficulty the first one changes.
"""

from __future__ import annotations

import ast
import cmath
import importlib
import re
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import sympy  # type: ignore[import-untyped]  # it has no types
from sympy.parsing.sympy_parser import parse_expr as sympy_parse  # type: ignore[import-untyped]  # it has no types

READ_AS_LITERALS = (
    "algorithmic.binary_matrix",
    "algorithmic.number_sorting",
    "algorithmic.spiral_matrix",
    "algorithmic.string_insertion",
    "games.n_queens",
)
"""Modules whose scorers call ``eval`` on an answer."""

READ_AS_FORMULAS = {
    "algebra.intermediate_integration": "sympy",
    "algebra.polynomial_multiplication": "sp",
    "algebra.simple_integration": "sympy",
    "games.countdown": "parse_expr",
    "games.puzzle24": "parse_expr",
}
"""Modules whose scorers call ``parse_expr`` on an answer, and the name by which they have it or its package."""

_LONGEST_FORMULA = 4_000
_LARGEST_EXPONENT = 10_000
_TOKEN = re.compile(r"\s+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[A-Za-z]\w*|\*\*|[-+*/(),]", re.ASCII)
_FUNCTIONS = frozenset(
    re.findall(
        r"\w+",
        "Abs acos acosh acot acoth acsc asec asin asinh atan atanh cbrt cos cosh cot coth csc erf erfi exp ln log pi "
        "root sec sin sinh sqrt tan tanh Ei Si Ci li Rational",
    )
)
_POINTS = ([sympy.Rational(7, 11)] * 9, [sympy.Rational(17, 13)] * 9)
_SURELY_NOT_ZERO = 1e-4
_CALLABLES_OF_ONE_LETTER = frozenset("NOQS")


def mend() -> None:
    """Put it right; calling it again changes nothing."""
    for name in READ_AS_LITERALS:
        vars(_module(name))["eval"] = literal
    for name, package in READ_AS_FORMULAS.items():
        vars(_module(name))[package] = formula if package == "parse_expr" else _Sympy()
    for name, (dataset, mended) in _SCORERS.items():
        task = getattr(_module(name), dataset)
        if "mended" not in vars(task):
            task.mended, task.score_answer = True, mended(task.score_answer)


def _module(name: str) -> Any:
    return importlib.import_module(f"reasoning_gym.{name}")


def literal(text: str) -> Any:
    """Return what a literal of Python says; in the place of ``eval``.

    Raises:
        ValueError: It is none.
    """
    try:
        return ast.literal_eval(text)
    except (SyntaxError, TypeError, MemoryError, RecursionError) as error:
        raise ValueError("it is no literal") from error


def formula(text: str, local_dict: dict[str, Any] | None = None) -> Any:
    """Return the sympy expression that a formula writes; in the place of ``sympy.parse_expr``.

    Numbers, letters, arithmetic and the elementary functions are read, and nothing else, so that what sympy then
    evaluates has neither attributes nor strings nor calls of anything but these functions.

    Raises:
        ValueError: It has something else in it, or is too long, or its exponents are.
    """
    names = local_dict or {}
    if len(text) > _LONGEST_FORMULA:
        raise ValueError(f"a formula has at most {_LONGEST_FORMULA} characters")
    place = 0
    while place < len(text):
        token = _TOKEN.match(text, place)
        if token is None:
            raise ValueError(f"a formula has no {text[place]!r} in it")
        word = token[0]
        if word[0].isalpha() and not (word in names or word in _FUNCTIONS or _is_variable(word)):
            raise ValueError(f"a formula has no {word!r} in it")
        place = token.end()
    _check_exponents(text)
    return sympy_parse(text, local_dict=names)


def _is_variable(word: str) -> bool:
    return len(word) == 1 and word not in _CALLABLES_OF_ONE_LETTER


def _check_exponents(text: str) -> None:
    """Refuse towers of powers and long exponents; what is left takes little time, or meets the limit."""
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, MemoryError, RecursionError) as error:
        raise ValueError("it is no formula") from error
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            for part in ast.walk(node.right):
                if isinstance(part, ast.Pow):
                    if not any(isinstance(below, ast.Name) for below in ast.walk(node.right)):
                        raise ValueError("a formula has no towers of powers in it")
                elif isinstance(part, ast.Constant) and abs(complex(str(part.value))) > _LARGEST_EXPONENT:
                    raise ValueError(f"an exponent is at most {_LARGEST_EXPONENT}")


def simplified(difference: Any) -> Any:
    """Return an expression simplified, or as it is where its value at some point shows that it is not 0."""
    for point in _POINTS:
        values = dict(zip(sorted(difference.free_symbols, key=str), point, strict=False))
        try:
            value = complex(difference.evalf(15, subs=values, maxn=100))
        except (TypeError, ValueError, ArithmeticError):
            continue  # it has no number there
        if cmath.isfinite(value) and abs(value) > _SURELY_NOT_ZERO:
            return difference
    return sympy.simplify(difference)


class _Sympy:
    """sympy, but for ``parse_expr`` and ``simplify``."""

    parse_expr = staticmethod(formula)
    simplify = staticmethod(simplified)

    def __getattr__(self, name: str) -> Any:
        return getattr(sympy, name)


Scorer = Callable[[Any, "str | None", dict[str, Any]], float]


def _of_halting(_: Scorer) -> Scorer:
    def score(dataset: Any, answer: str | None, entry: dict[str, Any]) -> float:
        return float(answer is not None and answer.strip().casefold() == str(entry["answer"]).casefold())

    return score


def _of_puzzle24(theirs: Scorer) -> Scorer:
    def score(dataset: Any, answer: str | None, entry: dict[str, Any]) -> float:
        used = sorted(map(int, re.findall(r"\b\d+\b", answer or "", re.ASCII)))
        return min(theirs(dataset, answer, entry), 1.0 if used == sorted(entry["metadata"]["numbers"]) else 0.01)

    return score


def _of_complex_numbers(theirs: Scorer) -> Scorer:
    def score(dataset: Any, answer: str | None, entry: dict[str, Any]) -> float:
        return 0.0 if "nan" in (answer or "").lower() else theirs(dataset, answer, entry)

    return score


def _of_coin_flips(theirs: Scorer) -> Scorer:
    def score(dataset: Any, answer: str | None, entry: dict[str, Any]) -> float:
        value = theirs(dataset, answer, entry)
        if value <= 0.0 or answer is None:
            return value
        given, gold = (float(Fraction(text.replace(",", ""))) for text in (answer, entry["answer"]))
        if abs(given - gold) <= _COIN_TOLERANCE:
            return value
        # Their partial score is the share of the shorter of two numbers that agrees; here of the longer.
        lengths = sorted(len(f"{number:.10g}") for number in (given, gold))
        return value * lengths[0] / lengths[1]

    return score


_COIN_TOLERANCE = 1e-4
"""Of ``coin_flip``'s own scorer."""

_SCORERS: dict[str, tuple[str, Callable[[Scorer], Scorer]]] = {
    "algorithmic.game_of_life_halting": ("GameOfLifeHaltingDataset", _of_halting),
    "games.puzzle24": ("Puzzle24Dataset", _of_puzzle24),
    "algebra.complex_arithmetic": ("ComplexArithmeticDataset", _of_complex_numbers),
    "probability.coin_flip": ("CoinFlipDataset", _of_coin_flips),
}
"""Data sets whose scorers give 1 to wrong answers, by module, and what their scorer becomes."""


def own_problems(dataset: Any) -> None:
    """Remember what a new data set has put into its class, as ``codeio`` does."""
    problems = getattr(type(dataset), "_jsonl_data", None)
    if problems is not None:
        dataset.own_problems = problems


def give_problems(dataset: Any) -> None:
    """Put what a data set has remembered into its class, before it is asked for a row."""
    problems = getattr(dataset, "own_problems", None)
    if problems is not None:
        type(dataset)._jsonl_data = problems
