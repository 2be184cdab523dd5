r"""Compares two forms part by part; what cannot be told by evaluation is asked of math-verify."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any, ClassVar

from gem_math.grading_forms import (
    Assignment,
    Choice,
    Equation,
    Form,
    Group,
    Inequality,
    Leaf,
    Many,
    Matrix,
    Opaque,
    Ratio,
    Union,
    Words,
)
from gem_math.grading_formulas import read_formula
from gem_math.grading_numbers import compare_formulas, proportional, value_of
from gem_math.grading_reading import read
from gem_math.grading_text import words_of
from gem_math.grading_units import DEGREE, go_together

# Six decimals are as many as math-verify compares; fewer are a rounded number, which is another one.
_MIN_DECIMALS = 6
_MAX_PARTS = 60
_DECIMAL = re.compile(r"^[-+]?\d*\.(\d+)$")
_SHORT_WORDS = {
    "no",
    "on",
    "yes",
    "odd",
    "even",
    "true",
    "none",
    "not",
    "ton",
    "one",
    "two",
    "ten",
    "net",
    "red",
    "blue",
}
_FUNCTION_NAME = re.compile(r"^([A-Za-z])\(([A-Za-z])\)$")
# An answer that has so many more characters than the gold one is no formula that equals it.
_MAX_MORE = 500
# No formula that math-verify reads has these.
_NO_LATEX = re.compile(r"[^\x20-\x7e]|[\"'#;@?`]|__")
_LOOSE_DIGITS = re.compile(r"\d\s+\d")
_CLOCK = re.compile(r"^\d{1,2}:\d\d$")


class Comparison:
    """Compares an answer with a gold answer.

    Args:
        ask: Called with the LaTeX of both for what evaluation does not tell; returns the verdict of math-verify.
        check_time: Called before each comparison of parts; raises when the time is up.
    """

    def __init__(self, ask: Callable[[str, str], bool], check_time: Callable[[], None] = lambda: None) -> None:
        self.ask = ask
        self.check_time = check_time
        self.quick = False

    def same(self, gold: Form, answer: Form) -> bool:
        """Return whether the answer is the gold one."""
        self.check_time()
        if isinstance(gold, Choice) or isinstance(answer, Choice):
            return self.choices(gold, answer)
        if isinstance(answer, Equation | Assignment) or isinstance(gold, Equation | Assignment):
            return self.equalities(gold, answer)
        if isinstance(gold, Inequality) or isinstance(answer, Inequality):
            return self.inequalities(gold, answer)
        if isinstance(gold, Many) or isinstance(answer, Many):
            return self.collections(gold, answer)
        for kind, compare in self.kinds.items():
            if isinstance(gold, kind) and isinstance(answer, kind):
                return bool(compare(self, gold, answer))
        return self.unlike(gold, answer)

    def decide(self, gold: str, answer: str) -> bool:
        """Ask math-verify."""
        too_long = len(answer) > _MAX_MORE + 2 * len(gold)
        return not (self.quick or too_long or _NO_LATEX.search(answer)) and self.ask(gold, answer)

    def choices(self, gold: Form, answer: Form) -> bool:
        """Compare where one is the letter of a multiple choice."""
        if isinstance(gold, Choice) and isinstance(answer, Choice):
            return gold.letter == answer.letter
        if isinstance(gold, Choice):
            if _letter(answer) == gold.letter:
                return True
            return gold.rest is not None and self.same(gold.rest, answer)
        if isinstance(answer, Choice):
            if _letter(gold) in set("ABCDEFGHIJ"):
                return _letter(gold) == answer.letter
            return answer.rest is not None and self.same(gold, answer.rest)
        return False

    def equalities(self, gold: Form, answer: Form) -> bool:
        """Compare where one is an equation, or a value with its name."""
        if isinstance(answer, Equation) and not self.consistent(answer):
            return False
        if isinstance(gold, Equation | Assignment) and isinstance(answer, Equation | Assignment):
            if isinstance(gold, Assignment) and isinstance(answer, Assignment):
                if _same_name(gold.name, answer.name):
                    return self.same(gold.value, answer.value)
                if (renamed := _renamed(gold.name, answer)) is not None:
                    return self.same(gold.value, renamed)
            return self.equations(gold, answer)
        if isinstance(gold, Many) or isinstance(answer, Many):
            return self.collections(_spread(gold), _spread(answer))
        if isinstance(answer, Equation | Assignment):
            return self.same(gold, answer.value)
        return isinstance(gold, Assignment) and self.same(gold.value, answer)

    def consistent(self, equality: Equation) -> bool:
        """Whether the numbers before the last sign are the last one; an answer such as 4 = 5 is none."""
        steps = [step for step in equality.steps if isinstance(step, Leaf) and step.formula is not None]
        value = equality.value
        if not isinstance(value, Leaf) or value.formula is None:
            return True
        return not any(
            step.formula is not None
            and not step.formula.letters
            and not value.formula.letters
            and compare_formulas(step.formula, value.formula) is False
            and not self.leaves(value, step)
            for step in steps
        )

    def equations(self, gold: Equation | Assignment, answer: Equation | Assignment) -> bool:
        """Compare two equations: their sides may be turned, moved and multiplied."""
        if not (gold.left and answer.left):
            return False
        first, second = (read_formula(f"({side.left})-({side.right})") for side in (gold, answer))
        if first is None or second is None:
            return _bare(gold.left + gold.right) == _bare(answer.left + answer.right)
        # x = 5 and y = 5 have nothing to do with each other, and 5 = 5 says nothing.
        if first.letters != second.letters or not first.letters:
            return False
        verdict = proportional(first, second)
        return self.decide(f"{gold.left}={gold.right}", f"{answer.left}={answer.right}") if verdict is None else verdict

    def inequalities(self, gold: Form, answer: Form) -> bool:
        """Compare where one says where a variable lies."""
        if isinstance(gold, Inequality) and isinstance(answer, Inequality):
            return _same_name(gold.name, answer.name) and self.same(gold.values, answer.values)
        if isinstance(gold, Opaque) or isinstance(answer, Opaque):
            return self.unlike(gold, answer)
        if isinstance(gold, Inequality):
            return isinstance(answer, Group | Union) and self.same(gold.values, answer)
        return isinstance(answer, Inequality) and isinstance(gold, Group | Union) and self.same(gold, answer.values)

    def collections(self, gold: Form, answer: Form) -> bool:
        """Compare where one is a set, or several answers."""
        ordered = gold if isinstance(gold, Group) else answer
        several = answer if isinstance(gold, Group) else gold
        if isinstance(ordered, Group) and isinstance(several, Many):
            return self.named_parts(ordered, several)
        if isinstance(gold, Words) or isinstance(answer, Words):
            return False
        golds = gold.items if isinstance(gold, Many) else (gold,)
        answers = answer.items if isinstance(answer, Many) else (answer,)
        if len(golds) > _MAX_PARTS or len(answers) > _MAX_PARTS:
            return False
        if (theirs := _in_named_order(golds, answers)) is not None:
            return self.in_order(golds, theirs)
        if len(golds) != len(answers):
            golds, answers = self.distinct(golds), self.distinct(answers)
        return self.matched(golds, answers)

    def named_parts(self, ordered: Group, several: Many) -> bool:
        """Compare (1, 2) with 1, 2, or with x = 1, y = 2: the names in the order of the alphabet."""
        values = [item for item in several.items if isinstance(item, Assignment)]
        names = [item.name for item in values]
        if several.is_set or len(several.items) < 2:
            return len(several.items) == 1 and self.same(ordered, several.items[0])
        items = several.items
        if len(values) == len(items) == len(set(names)):
            items = tuple(item.value for item in sorted(values, key=lambda item: item.name))
        elif values or any(isinstance(item, Leaf) and "infty" in item.text for item in ordered.items):
            return False
        return ordered.opening == "(" and ordered.closing == ")" and self.in_order(ordered.items, items)

    def distinct(self, items: Sequence[Form]) -> tuple[Form, ...]:
        """Leave out what is there twice, as far as evaluation tells."""
        kept: list[Form] = []
        quick, self.quick = self.quick, True
        for item in items:
            if not any(self.same(other, item) for other in kept):
                kept.append(item)
        self.quick = quick
        return tuple(kept)

    def matched(self, golds: Sequence[Form], answers: Sequence[Form]) -> bool:
        """Whether each gold part has an answer of its own; sameness is transitive, so the first that fits will do."""
        if len(golds) != len(answers):
            return False
        left = list(answers)
        for gold in golds:
            found = next((index for index, answer in enumerate(left) if self.same_part(gold, answer)), None)
            if found is None:
                return False
            del left[found]
        return True

    def same_part(self, gold: Form, answer: Form) -> bool:
        """Compare two parts of collections; there a set of one thing is not the thing."""
        sets = [isinstance(form, Many) and form.is_set for form in (gold, answer)]
        return sets[0] == sets[1] and self.same(gold, answer)

    def in_order(self, golds: Sequence[Form], answers: Sequence[Form]) -> bool:
        """Whether the parts are the same one by one."""
        return len(golds) == len(answers) and all(
            self.same(gold, answer) for gold, answer in zip(golds, answers, strict=True)
        )

    def groups(self, gold: Group, answer: Group) -> bool:
        """Compare tuples and intervals; with two parts the brackets matter."""
        if len(gold.items) == 2 and (gold.opening, gold.closing) != (answer.opening, answer.closing):
            return False
        return self.in_order(gold.items, answer.items)

    def unions(self, gold: Union, answer: Union) -> bool:
        """Compare sets put together, in any order."""
        return self.matched(gold.parts, answer.parts)

    def matrices(self, gold: Matrix, answer: Matrix) -> bool:
        """Compare cell by cell."""
        return len(gold.rows) == len(answer.rows) and all(map(self.in_order, gold.rows, answer.rows))

    def ratios(self, gold: Ratio, answer: Ratio) -> bool:
        """Compare ratios, 2:4 being 1:2, but no times of the clock."""
        if len(gold.parts) != len(answer.parts):
            return False
        if self.in_order(gold.parts, answer.parts):
            return True
        if _CLOCK.match(gold.text) or _CLOCK.match(answer.text):
            return False
        pairs = [(_exact(one), _exact(other)) for one, other in zip(gold.parts, answer.parts, strict=True)]
        factors = {one / other if one is not None and other else None for one, other in pairs}
        return len(factors) == 1 and None not in factors and 0 not in factors

    def texts(self, gold: Words, answer: Words) -> bool:
        """Compare words."""
        if gold.words == answer.words:
            return bool(gold.words) or gold.text == answer.text
        # Letters side by side may be a product as well as a word: RC is CR.
        runs = [word.text.strip() for word in (gold, answer)]
        return all(map(_is_product, runs)) and sorted(runs[0]) == sorted(runs[1])

    def opaques(self, gold: Opaque, answer: Opaque) -> bool:
        """Compare what math-verify alone can read."""
        return self.unlike(gold, answer)

    def unlike(self, gold: Form, answer: Form) -> bool:
        """Compare two different forms."""
        if isinstance(gold, Matrix) or isinstance(answer, Matrix):
            matrix, other = (gold, answer) if isinstance(gold, Matrix) else (answer, gold)
            if isinstance(matrix, Matrix) and isinstance(other, Group):
                return self.vectors(matrix, other)
        if {type(gold), type(answer)} == {Ratio, Leaf}:
            return self.fraction_of(gold, answer) or self.fraction_of(answer, gold)
        if {type(gold), type(answer)} == {Words, Leaf}:
            if _letter(gold) is not None:
                return _letter(gold) == _letter(answer)
            word, leaf = (gold, answer) if isinstance(gold, Words) else (answer, gold)
            product = isinstance(word, Words) and _is_product(word.text.strip())
            return product and isinstance(leaf, Leaf) and self.leaves(Leaf(_text_of(word) or ""), leaf)
        if isinstance(gold, Opaque) or isinstance(answer, Opaque):
            texts = [_text_of(form) for form in (gold, answer)]
            if None in texts or any(isinstance(form, Opaque) and form.has_words for form in (gold, answer)):
                return False
            return self.decide(str(texts[0]), str(texts[1]))
        return False

    def vectors(self, matrix: Matrix, group: Group) -> bool:
        """Compare a row or column, or a matrix in brackets, with a tuple."""
        if len(matrix.rows) == 1 or len(matrix.rows[0]) == 1:
            cells = matrix.rows[0] if len(matrix.rows) == 1 else tuple(row[0] for row in matrix.rows)
            if not any(isinstance(item, Group) for item in group.items):
                return group.opening == "(" and group.closing == ")" and self.in_order(cells, group.items)
        rows = [item.items for item in group.items if isinstance(item, Group) and item.opening == "["]
        return (
            len(rows) == len(group.items) == len(matrix.rows)
            and group.opening == "["
            and all(map(self.in_order, matrix.rows, rows))
        )

    def fraction_of(self, ratio: Form, leaf: Form) -> bool:
        """Whether a ratio of two numbers is the number."""
        if not isinstance(ratio, Ratio):
            return False
        if len(ratio.parts) != 2 or _CLOCK.match(ratio.text):
            return False
        above, below = map(_exact, ratio.parts)
        value = _exact(leaf)
        return above is not None and below is not None and value is not None and above == value * below != 0

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
        if (gold.unit == DEGREE) != (answer.unit == DEGREE) and self.formulas(_in_radians(gold), _in_radians(answer)):
            return r"\pi" in gold.text + answer.text
        return self.formulas(gold, answer)

    def formulas(self, gold: Leaf, answer: Leaf) -> bool:
        """Compare two formulas without units."""
        if _bare(gold.text) == _bare(answer.text):
            return True
        if (infinities := _infinities(gold.text, answer.text)) is not None:
            return infinities
        if len(gold.text) == len(answer.text) == 1 and gold.text.isalpha():
            return _letter(gold) == _letter(answer)
        if gold.formula is not None and answer.formula is not None:
            if (near := _rounded(gold, answer)) is not None:
                return near
            verdict = compare_formulas(gold.formula, answer.formula)
            if verdict is not None:
                return verdict
        return not _LOOSE_DIGITS.search(gold.text + " ;" + answer.text) and self.decide(gold.text, answer.text)

    kinds: ClassVar[dict[type, Callable[..., bool]]] = {
        Leaf: leaves,
        Group: groups,
        Union: unions,
        Matrix: matrices,
        Ratio: ratios,
        Words: texts,
        Opaque: opaques,
    }


def _bare(text: str) -> str:
    # 1 8 is not 18.
    return re.sub(r"(?<!\d)\s+|\s+(?!\d)", "", text)


def _same_name(first: str, second: str) -> bool:
    if first == second:
        return True
    # Words name nothing that a formula needs: "Area = 5" and "A = 5".
    return len(words_of(first)) > 3 or len(words_of(second)) > 3


def _in_named_order(golds: Sequence[Form], answers: Sequence[Form]) -> Sequence[Form] | None:
    """Return bare answers to a = 2, b = 3, which then stand in that order; None where names tell, or name one thing."""
    names = {re.sub(r"_.*", "", item.name) for item in golds if isinstance(item, Assignment)}
    bare = not any(isinstance(item, Assignment | Equation) for item in answers)
    return answers if bare and len(answers) == len(golds) == len(names) > 1 else None


def _spread(form: Form) -> Form:
    """Return (x, y) = (1, 2) as x = 1, y = 2, and x in {1, 2} as its values."""
    if not isinstance(form, Assignment):
        return form
    if isinstance(form.value, Many):
        return form.value
    names = form.name.strip("()").split(",")
    if isinstance(form.value, Group) and len(names) == len(form.value.items) > 1:
        return Many(tuple(Assignment(name, value) for name, value in zip(names, form.value.items, strict=True)))
    return form


def _renamed(name: str, answer: Assignment) -> Form | None:
    """Return the value of g(x) = … in the variable of the name g(n); None where the names differ otherwise."""
    ours, theirs = _FUNCTION_NAME.match(name), _FUNCTION_NAME.match(answer.name)
    if ours is None or theirs is None or ours[1] != theirs[1] or not answer.right:
        return None
    tokens = re.findall(r"\\[a-zA-Z]+|.", answer.right, re.DOTALL)
    if ours[2] in tokens:
        return None
    return read("".join(ours[2] if token == theirs[2] else token for token in tokens))


def _letter(form: Form) -> str | None:
    """Return the letter that an answer to a multiple choice may consist of."""
    if isinstance(form, Leaf) and len(form.text) == 1 and form.text.isalpha():
        # Beyond J no choice goes: there small and capital letters differ.
        return form.text.upper() if form.text.upper() <= "J" else form.text
    if isinstance(form, Words) and len(form.words) == 1:
        return form.words.upper() if form.words <= "j" else form.words
    return None


def _exact(form: Form) -> Fraction | None:
    if not isinstance(form, Leaf) or form.formula is None or form.base is not None or form.percent:
        return None
    value = value_of(form.formula)
    return value if isinstance(value, Fraction) else None


def _is_product(run: str) -> bool:
    return re.fullmatch(r"[A-Za-z]{2,4}", run) is not None and run.lower() not in _SHORT_WORDS


def _text_of(form: Form) -> str | None:
    if isinstance(form, Words):
        return form.text if _is_product(form.text.strip()) else None
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
    value = _exact(gold)
    return value is not None and 0 < abs(value) < 1


def _infinities(first: str, second: str) -> bool | None:
    signs = [{r"\infty": 1, r"+\infty": 1, r"-\infty": -1}.get(_bare(text)) for text in (first, second)]
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
