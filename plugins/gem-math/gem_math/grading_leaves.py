r"""Compares two formulas with what stands behind them: units, per cent, the base of their digits."""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from typing import Any

from gem_math.grading_forms import Form, Inequality, Leaf, Matrix, Opaque, Words
from gem_math.grading_numbers import compare_formulas, value_of
from gem_math.grading_units import DEGREE, RADIAN, go_together

# Six decimals are as many as math-verify compares; fewer are a rounded number, which is another one.
_MIN_DECIMALS = 6
_DECIMAL = re.compile(r"^[-+]?\d*\.(\d+)$")
_SHORT_WORDS = {
    "no", "on", "yes", "odd", "even", "true", "none", "not", "ton", "one", "two", "ten", "net", "red", "blue",
}  # fmt: skip
# An answer that has so many more characters than the gold one is no formula that equals it.
_MAX_MORE = 500
# No formula that math-verify reads has these.
_NO_LATEX = re.compile(r"[^\x20-\x7e]|[\"'#;@?`]|__")
_LOOSE_DIGITS = re.compile(r"\d\s+\d")


class LeafComparison:
    """Compares formulas with their units.

    Args:
        ask: Called with the LaTeX of both for what evaluation does not tell; returns the verdict of math-verify.
        check_time: Called before each comparison of parts; raises when the time is up.
    """

    def __init__(self, ask: Callable[[str, str], bool], check_time: Callable[[], None] = lambda: None) -> None:
        self.ask = ask
        self.check_time = check_time
        self.quick = False

    def decide(self, gold: str, answer: str) -> bool:
        """Ask math-verify."""
        too_long = len(answer) > _MAX_MORE + 2 * len(gold)
        return not (self.quick or too_long or _NO_LATEX.search(answer)) and self.ask(gold, answer)

    def leaves(self, gold: Leaf, answer: Leaf) -> bool:
        """Compare two formulas with their units."""
        if not go_together(gold.unit, answer.unit):
            return False
        if gold.base is not None or answer.base is not None:
            return _same_digits(gold, answer)
        if gold.percent != answer.percent:
            if any(leaf.unit is not None and leaf.unit.measures for leaf in (gold, answer)):
                return False
            # 25 % is 1/4, and the answer 25 to a question for a percentage.
            other = Leaf(rf"\frac{{{answer.text}}}{{100}}") if answer.percent else answer
            mine = Leaf(rf"\frac{{{gold.text}}}{{100}}") if gold.percent else gold
            if self.formulas(mine, other):
                return True
            return not (answer.percent and _is_part(gold)) and self.formulas(Leaf(gold.text), Leaf(answer.text))
        if gold.unit is not None and answer.unit is not None and gold.unit.factor != answer.unit.factor:
            return self.formulas(_scaled(gold, gold.unit.factor), _scaled(answer, answer.unit.factor))
        if RADIAN in {gold.unit, answer.unit}:
            angles = [Leaf(leaf.text) if leaf.unit == RADIAN else _in_radians(leaf) for leaf in (gold, answer)]
            return self.formulas(*angles)
        if (gold.unit == DEGREE) != (answer.unit == DEGREE) and self.formulas(_in_radians(gold), _in_radians(answer)):
            return r"\pi" in gold.text + answer.text
        return self.formulas(gold, answer)

    def formulas(self, gold: Leaf, answer: Leaf) -> bool:
        """Compare two formulas without units."""
        if bare(gold.text) == bare(answer.text):
            return True
        if (infinities := _infinities(gold.text, answer.text)) is not None:
            return infinities
        if len(gold.text) == len(answer.text) == 1 and gold.text.isalpha():
            return letter_of(gold) == letter_of(answer)
        if gold.formula is not None and answer.formula is not None:
            if (near := _rounded(gold, answer)) is not None:
                return near
            verdict = compare_formulas(gold.formula, answer.formula)
            if verdict is not None:
                return verdict
        return not _LOOSE_DIGITS.search(gold.text + " ;" + answer.text) and self.decide(gold.text, answer.text)


def bare(text: str) -> str:
    """Return a formula without white space, but for what keeps digits apart."""
    # 1 8 is not 18.
    return re.sub(r"(?<!\d)\s+|\s+(?!\d)", "", text)


def letter_of(form: Form) -> str | None:
    """Return the letter that an answer to a multiple choice may consist of."""
    if isinstance(form, Leaf) and len(form.text) == 1 and form.text.isalpha():
        # Beyond J no choice goes: there small and capital letters differ.
        return form.text.upper() if form.text.upper() <= "J" else form.text
    if isinstance(form, Words) and len(form.words) == 1:
        return form.words.upper() if form.words <= "j" else form.words
    return None


def exact_of(form: Form) -> Fraction | None:
    """Return the value of a rational number; None of anything else."""
    if not isinstance(form, Leaf) or form.formula is None or form.base is not None or form.percent:
        return None
    value = value_of(form.formula)
    return value if isinstance(value, Fraction) else None


def is_product(run: str) -> bool:
    """Return whether a run of letters may be a product as well as a word."""
    return re.fullmatch(r"[A-Za-z]{2,4}", run) is not None and run.lower() not in _SHORT_WORDS


def product_of(word: Words) -> Leaf | None:
    """Return the formula that words with letters side by side may be as well, as in abc/4R; None of true words."""
    text = word.text.strip()
    runs = re.findall(r"(?<![\\A-Za-z])[A-Za-z]{2,}", text)
    if (
        not re.search("[A-Za-z]", text)
        or "\\text" in text
        or word.words.startswith("date ")
        or not all(is_product(run) and len(set(run)) == len(run) for run in runs)
    ):
        return None
    leaf = Leaf(text)
    return leaf if leaf.formula is not None else None


def text_of(form: Form) -> str | None:
    """Return the LaTeX of a form that math-verify may read; None of others."""
    if isinstance(form, Words):
        return form.text if is_product(form.text.strip()) else None
    if isinstance(form, Leaf):
        return form.text if form.unit is None and not form.percent and form.base is None else None
    return form.text if isinstance(form, Opaque | Inequality | Matrix) else None


def _scaled(leaf: Leaf, factor: Fraction) -> Leaf:
    return Leaf(rf"({leaf.text})\cdot\frac{{{factor.numerator}}}{{{factor.denominator}}}")


def _in_radians(leaf: Leaf) -> Leaf:
    return Leaf(rf"({leaf.text})\cdot\frac{{\pi}}{{180}}") if leaf.unit == DEGREE else Leaf(leaf.text)


def _same_digits(gold: Leaf, answer: Leaf) -> bool:
    if gold.base is None:
        return answer.base == 10 and gold.text == answer.text
    return answer.base in {None, gold.base} and gold.text.upper() == (answer.text.lstrip("0") or "0").upper()


def _is_part(gold: Leaf) -> bool:
    """Whether a gold number is a part of one, such as a probability: 0.5 asks for no percentage."""
    value = exact_of(gold)
    return value is not None and 0 < abs(value) < 1


def _infinities(first: str, second: str) -> bool | None:
    signs = [{r"\infty": 1, r"+\infty": 1, r"-\infty": -1}.get(bare(text)) for text in (first, second)]
    if signs == [None, None]:
        return None
    return signs[0] == signs[1]


def _rounded(gold: Leaf, answer: Leaf) -> bool | None:
    """Compare a decimal of six places or more with what has no end as a decimal; None where it is none of these."""
    for decimal, other in ((answer, gold), (gold, answer)):
        match = _DECIMAL.match(decimal.text)
        if match is None or _DECIMAL.match(other.text) or len(match[1]) < _MIN_DECIMALS:
            continue
        if decimal.formula is None or other.formula is None or len(match[1]) > 60:
            return None
        value, written = value_of(other.formula), value_of(decimal.formula)
        if value is None or not isinstance(written, Fraction) or _terminates(value) or _is_complex(value):
            return None
        # Zeros in front tell nothing: 0.000001 is no third of it.
        if len((decimal.text.lstrip("+-").replace(".", "")).lstrip("0")) < _MIN_DECIMALS:
            return False
        value = value if isinstance(value, Fraction) else Fraction(str(value.real))
        return abs(value - written) <= Fraction(1, 10 ** len(match[1]))
    return None


def _is_complex(value: Any) -> bool:
    """Whether a value has an imaginary part beyond what rounding leaves."""
    return not isinstance(value, Fraction) and abs(value.imag) > 1e-60


def _terminates(value: Any) -> bool:
    if not isinstance(value, Fraction):
        return False
    below = value.denominator
    for prime in (2, 5):
        while below % prime == 0:
            below //= prime
    return below == 1
