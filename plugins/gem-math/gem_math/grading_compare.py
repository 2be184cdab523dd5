r"""Compares two forms part by part; what cannot be told by evaluation is asked of math-verify."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import ClassVar

from gem_math.grading_forms import (
    Assignment,
    Cases,
    Choice,
    Congruence,
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
from gem_math.grading_leaves import LeafComparison, bare, exact_of, is_product, letter_of, product_of, text_of
from gem_math.grading_names import renamed, same_name
from gem_math.grading_numbers import compare_formulas, proportional, value_of
from gem_math.grading_regions import same_region

_MAX_PARTS = 60
_PLACES = re.compile(r"-?\d*\.(\d{1,15})")
_CLOCK = re.compile(r"^\d{1,2}:\d\d$")


_OTHERWISE = ("otherwise",)
_FILLERS = {"is", "are", "a", "an", "be", "number", "integer", "if", "for", "when", "where"}


class Comparison(LeafComparison):
    """Compares an answer with a gold answer."""

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
        if isinstance(gold, Congruence) or isinstance(answer, Congruence):
            return self.congruences(gold, answer)
        for kind, compare in self.kinds.items():
            if isinstance(gold, kind) and isinstance(answer, kind):
                return bool(compare(self, gold, answer))
        return self.unlike(gold, answer)

    def choices(self, gold: Form, answer: Form) -> bool:
        """Compare where one is the letter of a multiple choice."""
        if isinstance(gold, Choice) and isinstance(answer, Choice):
            return gold.letter == answer.letter
        if isinstance(gold, Choice):
            if letter_of(answer) == gold.letter:
                return True
            return gold.rest is not None and self.same(gold.rest, answer)
        if isinstance(answer, Choice):
            if letter_of(gold) in set("ABCDEFGHIJ"):
                return letter_of(gold) == answer.letter
            return answer.rest is not None and self.same(gold, answer.rest)
        return False

    def equalities(self, gold: Form, answer: Form) -> bool:
        """Compare where one is an equation, or a value with its name."""
        if isinstance(answer, Equation | Assignment) and not self.consistent(answer):
            return False
        if isinstance(gold, Equation | Assignment) and isinstance(answer, Equation | Assignment):
            if isinstance(gold, Assignment) and isinstance(answer, Assignment):
                if same_name(gold.name, answer.name):
                    return self.same(gold.value, answer.value)
                if (value := renamed(gold.name, answer)) is not None:
                    return self.same(gold.value, value)
            return self.equations(gold, answer)
        if isinstance(gold, Many) or isinstance(answer, Many):
            return self.collections(_spread(gold), _spread(answer))
        if isinstance(answer, Equation | Assignment):
            return self.same(gold, answer.value)
        return isinstance(gold, Assignment) and self.same(gold.value, answer)

    def consistent(self, equality: Equation | Assignment) -> bool:
        """Whether the numbers before the last sign are the last one; an answer such as 4 = 5 or x = 4 = 5 is none."""
        return not any(self.contradict(step, equality.value) for step in equality.steps)

    def contradict(self, step: Form, value: Form) -> bool:
        """Whether two sides of an equation are different numbers, or have such in the same place."""
        if isinstance(step, Group) and isinstance(value, Group) and len(step.items) == len(value.items):
            return any(map(self.contradict, step.items, value.items))
        if not (isinstance(step, Leaf) and isinstance(value, Leaf) and step.formula and value.formula):
            return False
        if step.formula.letters or value.formula.letters or compare_formulas(step.formula, value.formula) is not False:
            return False
        return not _rounds_to(step, value) and not self.leaves(value, step)

    def equations(self, gold: Equation | Assignment, answer: Equation | Assignment) -> bool:
        """Compare two equations: their sides may be turned, moved and multiplied."""
        if not (gold.left and answer.left):
            return False
        first, second = (read_formula(f"({side.left})-({side.right})") for side in (gold, answer))
        if first is None or second is None:
            return bare(gold.left + gold.right) == bare(answer.left + answer.right)
        # x = 5 and y = 5 have nothing to do with each other, and 5 = 5 says nothing.
        if first.letters != second.letters or not first.letters:
            return False
        verdict = proportional(first, second)
        return self.decide(f"{gold.left}={gold.right}", f"{answer.left}={answer.right}") if verdict is None else verdict

    def inequalities(self, gold: Form, answer: Form) -> bool:
        """Compare where one says where a variable lies."""
        if isinstance(gold, Inequality) and isinstance(answer, Inequality):
            return same_name(gold.name, answer.name) and self.same(gold.values, answer.values)
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
        # Intervals side by side are their union, but two points are none.
        if isinstance(gold, Union) or (isinstance(answer, Union) and _has_interval(gold)):
            return self.matched(*(form.parts if isinstance(form, Union) else _groups(form) for form in (gold, answer)))
        golds = gold.items if isinstance(gold, Many) else (gold,)
        answers = answer.items if isinstance(answer, Many) else (answer,)
        if len(golds) > _MAX_PARTS or len(answers) > _MAX_PARTS:
            return False
        if (theirs := _in_named_order(golds, answers)) is not None:
            return self.in_order(golds, theirs)
        if len(golds) != len(answers):
            golds, answers = self.distinct(golds), self.distinct(answers)
        return self.matched(golds, answers)

    def congruences(self, gold: Form, answer: Form) -> bool:
        """Compare what is left modulo a number; where one side names none, the residue alone."""
        if isinstance(gold, Congruence) and isinstance(answer, Congruence):
            named = not (gold.name and answer.name) or same_name(gold.name, answer.name)
            return named and self.same(gold.modulus, answer.modulus) and self.same(gold.least, answer.least)
        if isinstance(gold, Congruence):
            return self.same(gold.residue, answer) or self.same(gold.least, answer)
        # 12 mod 5 is the number 2, and x = 12 (mod 5) what is asked for where that is 12.
        if not isinstance(answer, Congruence):
            return False
        return self.same(gold, answer.least) or (answer.name != "" and self.same(gold, answer.residue))

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

    def cases(self, gold: Cases, answer: Cases) -> bool:
        """Compare values with conditions, in any order; one condition of either side may say 'otherwise'."""
        if len(gold.rows) != len(answer.rows):
            return False
        left = list(answer.rows)
        lone: list[tuple[Form, Form | None]] = []
        for row in gold.rows:
            found = next((index for index, other in enumerate(left) if self.rows(row, other)), None)
            if found is None:
                lone.append(row)
            else:
                del left[found]
        if len(lone) == len(left) == 1 and _OTHERWISE in {_words(lone[0][1]), _words(left[0][1])}:
            return self.same(lone[0][0], left[0][0])
        return not lone

    def rows(self, gold: tuple[Form, Form | None], answer: tuple[Form, Form | None]) -> bool:
        """Compare two values with their conditions."""
        (value, condition), (other_value, other_condition) = gold, answer
        if condition is None or other_condition is None:
            return condition is other_condition and self.same(value, other_value)
        words = _words(condition)
        alike = words is not None and words == _words(other_condition)
        return (alike or self.same(condition, other_condition)) and self.same(value, other_value)

    def ratios(self, gold: Ratio, answer: Ratio) -> bool:
        """Compare ratios, 2:4 being 1:2, but no times of the clock."""
        if len(gold.parts) != len(answer.parts):
            return False
        if self.in_order(gold.parts, answer.parts):
            return True
        if _CLOCK.match(gold.text) or _CLOCK.match(answer.text):
            return False
        texts = [[_value_text(part) for part in ratio.parts] for ratio in (gold, answer)]
        if any(text is None for side in texts for text in side):
            return False
        (first, *others), (first_answer, *other_answers) = texts
        return all(
            self.formulas(Leaf(f"({one})({first_answer})"), Leaf(f"({other})({first})"))
            for one, other in zip(others, other_answers, strict=True)
        )

    def texts(self, gold: Words, answer: Words) -> bool:
        """Compare words."""
        if gold.words == answer.words:
            return bool(gold.words) or gold.text == answer.text
        # Letters side by side may be a product as well as a word: RC is CR.
        runs = [word.text.strip() for word in (gold, answer)]
        if all(map(is_product, runs)):
            return sorted(runs[0]) == sorted(runs[1])
        products = [product_of(word) for word in (gold, answer)]
        return products[0] is not None and products[1] is not None and self.leaves(products[0], products[1])

    def opaques(self, gold: Opaque, answer: Opaque) -> bool:
        """Compare what math-verify alone can read."""
        return bare(gold.text) == bare(answer.text) or self.unlike(gold, answer)

    def unlike(self, gold: Form, answer: Form) -> bool:
        """Compare two different forms."""
        if isinstance(gold, Matrix) or isinstance(answer, Matrix):
            matrix, other = (gold, answer) if isinstance(gold, Matrix) else (answer, gold)
            if isinstance(matrix, Matrix) and isinstance(other, Group):
                return self.vectors(matrix, other)
        if {type(gold), type(answer)} == {Ratio, Leaf}:
            return self.fraction_of(gold, answer) or self.fraction_of(answer, gold)
        if {type(gold), type(answer)} == {Words, Leaf}:
            if letter_of(gold) is not None:
                return letter_of(gold) == letter_of(answer)
            word, leaf = (gold, answer) if isinstance(gold, Words) else (answer, gold)
            product = product_of(word) if isinstance(word, Words) else None
            return product is not None and isinstance(leaf, Leaf) and self.leaves(product, leaf)
        if isinstance(gold, Opaque) or isinstance(answer, Opaque):
            if (verdict := same_region(gold, answer)) is not None:
                return verdict
            texts = [text_of(form) for form in (gold, answer)]
            if not all(texts) or any(isinstance(form, Opaque) and form.has_words for form in (gold, answer)):
                return False
            return self.decide(str(texts[0]), str(texts[1]))
        return False

    def vectors(self, matrix: Matrix, group: Group) -> bool:
        """Compare a row or column, or a matrix in brackets, with a tuple."""
        if len(matrix.rows) == 1 or len(matrix.rows[0]) == 1:
            cells = matrix.rows[0] if len(matrix.rows) == 1 else tuple(row[0] for row in matrix.rows)
            if not any(isinstance(item, Group) for item in group.items):
                return group.opening + group.closing in {"()", "[]"} and self.in_order(cells, group.items)
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
        above, below = map(exact_of, ratio.parts)
        value = exact_of(leaf)
        return above is not None and below is not None and value is not None and above == value * below != 0

    kinds: ClassVar[dict[type, Callable[..., bool]]] = {
        Leaf: LeafComparison.leaves,
        Group: groups,
        Union: unions,
        Matrix: matrices,
        Cases: cases,
        Ratio: ratios,
        Words: texts,
        Opaque: opaques,
    }


def _rounds_to(step: Leaf, value: Leaf) -> bool:
    """Whether a decimal is what a number is near to, as the last of x = 1/3 = 0.33."""
    places = _PLACES.fullmatch(value.text)
    numbers = [value_of(leaf.formula) for leaf in (step, value) if leaf.formula is not None]
    if places is None or len(numbers) < 2 or None in numbers:
        return False
    try:
        first, second = (complex(number) for number in numbers if number is not None)
    except OverflowError:
        return False
    return abs(first - second) < 10.0 ** -len(places[1])


def _value_text(form: Form) -> str | None:
    """Return the formula of a number that is not zero; None of anything else."""
    if not isinstance(form, Leaf) or form.formula is None or form.base is not None or form.percent:
        return None
    value = value_of(form.formula)
    return None if value is None or value == 0 else form.text


def _groups(form: Form) -> tuple[Form, ...]:
    items = form.items if isinstance(form, Many) and not form.is_set else ()
    return items if all(isinstance(item, Group) for item in items) else ()


def _has_interval(form: Form) -> bool:
    """Whether one of several pairs in brackets can only be an interval."""
    return any(
        isinstance(item, Group)
        and (item.opening + item.closing != "()" or any("infty" in (text_of(end) or "") for end in item.items))
        for item in _groups(form)
    )


def _words(condition: Form | None) -> tuple[str, ...] | None:
    """Return what a condition says in words, without those that say nothing, as in 'n even' and 'n is even'."""
    if not isinstance(condition, Words):
        return None
    return tuple(word for word in condition.words.split() if word not in _FILLERS)


def _in_named_order(golds: Sequence[Form], answers: Sequence[Form]) -> Sequence[Form] | None:
    """Return bare answers to a = 2, b = 3, which then stand in that order; None where names tell, or name one thing."""
    names = {re.sub(r"_.*", "", item.name) for item in golds if isinstance(item, Assignment)}
    unnamed = not any(isinstance(item, Assignment | Equation) for item in answers)
    return answers if unnamed and len(answers) == len(golds) == len(names) > 1 else None


def _spread(form: Form) -> Form:
    """Return (x, y) = (1, 2) as x = 1, y = 2, and x in {1, 2} as x = 1, x = 2."""
    if not isinstance(form, Assignment):
        return form
    if isinstance(form.value, Many):
        return Many(tuple(Assignment(form.name, item) for item in form.value.items), form.value.is_set)
    names = form.name.strip("()").split(",")
    if isinstance(form.value, Group) and len(names) == len(form.value.items) > 1:
        return Many(tuple(Assignment(name, value) for name, value in zip(names, form.value.items, strict=True)))
    return form
