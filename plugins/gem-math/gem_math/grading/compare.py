r"""Compares two forms part by part.

Numbers, words and what consists of these are compared wherever this runs. Formulas need ``gem_math.grading.formulas``,
which may take forever and is there in the processes of the pool alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

from gem_math.grading.arithmetic import number_of, same_value
from gem_math.grading.forms import (
    Cases,
    Choice,
    Congruence,
    Equality,
    Form,
    Inequality,
    Opaque,
    Parts,
    Words,
    is_interval,
    is_region,
    name_of,
)
from gem_math.grading.quantities import Leaf, equal_pairs, exact, is_numeric
from gem_math.grading.structure import read, read_words
from gem_math.grading.text import text_inside
from gem_math.grading.words import WORDS

_MAX_PARTS = 60
# An answer that has so many more characters than the gold one is no formula that equals it.
_MAX_MORE = 500
_DECIMAL = re.compile(r"^[-+]?\d*\.(\d+)$")
# Six decimals are as many as math-verify compares, fewer are a rounded number, which is another one; of more than 45
# the parser, which has 50 digits, is not sure.
_LONG_DECIMAL = re.compile(r"^[-+]?\d*\.(\d{6,45})$")
_CLOCK = re.compile(r"^\d{1,2}:\d\d$")
_NAME_WORD = re.compile(r"[A-Za-z][a-z]{3,}")
_FUNCTION_NAME = re.compile(r"^([A-Za-z])\(([A-Za-z])\)$")
_INFINITIES = {r"\infty": 1, r"+\infty": 1, r"-\infty": -1}

_UNORDERED = {"list", "or", "set"}

Row = tuple[Form, Form | None]


class NeedsParserError(Exception):
    """A formula has to be read, which this process does not do."""


class Comparison:
    """Compares an answer with a gold answer; ``note`` says why a pair of formulas could not be compared, if one was.

    Args:
        parser: The module ``gem_math.grading.formulas``. Without it, whatever needs it raises NeedsParserError.
    """

    def __init__(self, parser: ModuleType | None) -> None:
        self._parser = parser
        self.note = ""

    @property
    def parser(self) -> ModuleType:
        """What reads and compares formulas."""
        if self._parser is None:
            raise NeedsParserError
        return self._parser

    def same(self, gold: Form, answer: Form) -> bool:
        """Return whether the answer is the gold one."""
        if isinstance(gold, Opaque) and isinstance(answer, Opaque) and _bare(gold.text) == _bare(answer.text):
            return True
        if isinstance(gold, Choice) or isinstance(answer, Choice):
            return self.choices(gold, answer)
        if isinstance(gold, Equality) or isinstance(answer, Equality):
            return self.equalities(gold, answer)
        if is_region(gold) or is_region(answer):
            return self.regions(gold, answer)
        if isinstance(gold, Congruence) or isinstance(answer, Congruence):
            return self.congruences(gold, answer)
        if isinstance(gold, Parts) or isinstance(answer, Parts):
            return self.parts(gold, answer)
        if isinstance(gold, Leaf) and isinstance(answer, Leaf):
            return self.leaves(gold, answer)
        if isinstance(gold, Cases) and isinstance(answer, Cases):
            return self.cases(gold, answer)
        if isinstance(gold, Opaque) or isinstance(answer, Opaque):
            return self.opaques(gold, answer)
        return self.words(gold, answer)

    def part_right(self, gold: Form, answer: Form) -> float:
        """Return the fraction of the parts of a list or set that the answer has; 0 for an answer with more parts."""
        if not (isinstance(gold, Parts) and gold.kind in _UNORDERED and gold.items) or isinstance(answer, Words):
            return 0.0
        answers = _members(answer)
        return len(self.pairs(gold.items, answers)) / len(gold.items) if len(answers) <= len(gold.items) else 0.0

    def ask(self, function: Callable[..., bool], *arguments: Any) -> bool:
        """Return what a function of formulas says; False where one of them cannot be read, which ``note`` tells."""
        try:
            return bool(function(*arguments))
        except Exception as error:  # noqa: BLE001  # the grammar and sympy raise whatever
            self.note = self.note or f"{type(error).__name__}: {error}".partition("\n")[0][:300]
            return False

    def leaves(self, gold: Leaf, answer: Leaf) -> bool:
        """Compare two formulas with their units."""
        return any(self.formulas(one, other) for one, other in equal_pairs(gold, answer))

    def formulas(self, gold: str, answer: str) -> bool:
        """Compare two formulas without units."""
        one, other = _bare(gold), _bare(answer)
        if one == other:
            return True
        if one in _INFINITIES or other in _INFINITIES:
            return _INFINITIES.get(one) == _INFINITIES.get(other)
        if len(one) == len(other) == 1 and one.isalpha():
            return letter_of(Leaf(one)) == letter_of(Leaf(other))
        if (near := self.rounded(gold, answer)) is not None:
            return near
        numbers = number_of(gold), number_of(answer)
        if None not in numbers:
            return numbers[0] == numbers[1]
        if (verdict := same_value(gold, answer)) is not None:
            return verdict
        return len(answer) <= _MAX_MORE + 2 * len(gold) and self.ask(self.parser.same, gold, answer)

    def rounded(self, gold: str, answer: str) -> bool | None:
        """Compare a decimal of many places with what has no end as a decimal; None where it is none of these."""
        for decimal, other in ((answer, gold), (gold, answer)):
            match = _LONG_DECIMAL.match(decimal)
            if match is not None and not _DECIMAL.match(other) and is_numeric(other):
                near: bool | None = self.parser.rounds_to(other, decimal, len(match[1]))
                return near
        return None

    def choices(self, gold: Form, answer: Form) -> bool:
        """Compare where one is the letter of a multiple choice, or a label: it, and what stands behind it."""
        choice, other = (gold, answer) if isinstance(gold, Choice) else (answer, gold)
        if not isinstance(choice, Choice):
            return False
        if isinstance(other, Choice):
            rests = choice.rest is None or other.rest is None or self.same(choice.rest, other.rest)
            return rests and choice.letter == other.letter
        letter = letter_of(other)
        if letter is not None and letter <= "J" and (letter == choice.letter or other is gold):
            return letter == choice.letter
        value = other.value if isinstance(other, Equality) and other.name == choice.letter else other
        return choice.rest is not None and self.same(choice.rest, value)

    def equalities(self, gold: Form, answer: Form) -> bool:
        """Compare where one is an equation, or a value with its name."""
        if isinstance(answer, Equality) and any(self.contradict(step, answer.value) for step in answer.steps):
            return False
        if isinstance(gold, Equality) and isinstance(answer, Equality):
            if gold.name and answer.name:
                if same_name(gold.name, answer.name):
                    return self.same(gold.value, answer.value)
                if (value := _renamed(gold.name, answer)) is not None:
                    return self.same(gold.value, value)
            return self.equations(gold, answer)
        one, other = _named_parts(gold), _named_parts(answer)
        if isinstance(one, Parts) and isinstance(other, Parts) and {one.kind, other.kind} & _UNORDERED:
            return self.parts(one, other)
        named, bare = (gold, answer) if isinstance(gold, Equality) else (answer, gold)
        if not isinstance(named, Equality) or (named is gold and not named.name):
            return False
        return (not name_of(bare) or same_name(named.name, name_of(bare))) and self.same(
            *((named.value, answer) if named is gold else (gold, named.value))
        )

    def contradict(self, step: Form, value: Form) -> bool:
        """Whether two sides of an equation, as in x = 41 = 42, are different numbers or have such in the same place."""
        if isinstance(step, Parts) and isinstance(value, Parts) and len(step.items) == len(value.items):
            return any(map(self.contradict, step.items, value.items))
        if not (isinstance(step, Leaf) and isinstance(value, Leaf)):
            return False
        if not (is_numeric(step.text) and is_numeric(value.text)) or self.leaves(value, step):
            return False
        decimal = _DECIMAL.fullmatch(value.text)
        return bool(self.parser.contradict(step.text, value.text, len(decimal[1]) if decimal else None))

    def equations(self, gold: Equality, answer: Equality) -> bool:
        """Compare two equations: their sides may be turned, moved and multiplied."""
        if gold.sides is None or answer.sides is None:
            return False
        if _bare("=".join(gold.sides)) == _bare("=".join(answer.sides)):
            return True
        return self.ask(self.parser.same_equation, gold.sides, answer.sides)

    def regions(self, gold: Form, answer: Form) -> bool:
        """Compare where one says where letters lie: as multiples of one another, or as sets of one letter's values."""
        name = name_of(gold) or name_of(answer)
        if name_of(gold) and name_of(answer) and not same_name(name_of(gold), name_of(answer)):
            return False
        units = {form.unit for form in (gold, answer) if isinstance(form, Inequality) and form.unit is not None}
        if len(units) > 1:
            return False
        if self.ask(self.parser.same_conditions, gold, answer, name):
            return True
        if isinstance(gold, Parts) and isinstance(answer, Parts):
            # Intervals side by side are their union, but two points are none.
            vague = gold.kind == "list" and not any(is_interval(item) or is_region(item) for item in gold.items)
            if vague and answer.kind == "union":
                return False
            if self.matched(gold.items, answer.items):
                return True
        return self.ask(self.parser.same_sets, gold, answer)

    def parts(self, gold: Form, answer: Form) -> bool:
        """Compare where one side has several parts."""
        kinds = [form.kind if isinstance(form, Parts) else "" for form in (gold, answer)]
        if _UNORDERED & set(kinds):
            return self.collections(gold, answer)
        if "" in kinds:
            return self.single(gold, answer) or self.single(answer, gold)
        one, other = _items(gold), _items(answer)
        if "matrix" in kinds and set(kinds) != {"matrix"}:
            return self.vectors(*((one, answer) if kinds[0] == "matrix" else (other, gold)))
        # With two parts the brackets matter.
        if len(one) == len(other) == 2 and kinds[0] != kinds[1]:
            return False
        if kinds == ["ratio", "ratio"]:
            return self.in_order(one, other) or self.ratios(gold, answer)
        return ("ratio" in kinds) == (kinds[0] == kinds[1] == "ratio") and self.in_order(one, other)

    def single(self, several: Form, other: Form) -> bool:
        """Compare a ratio with a number, and a matrix with what is none as written."""
        if not isinstance(several, Parts):
            return False
        if several.kind == "matrix":
            return self.opaques(several, other)
        if several.kind != "ratio" or len(several.items) != 2 or _CLOCK.match(several.text):
            return False
        (above, below), value = map(exact, several.items), exact(other)
        return above is not None and below is not None and value is not None and above == value * below != 0

    def collections(self, gold: Form, answer: Form) -> bool:
        """Compare where one is a set, or several answers."""
        ordered, several = (answer, gold) if isinstance(gold, Parts) and gold.kind in _UNORDERED else (gold, answer)
        if isinstance(ordered, Parts) and isinstance(several, Parts) and ordered.kind[0] in "([":
            return self.named_parts(ordered, several)
        golds, answers = _members(gold), _members(answer)
        golds, answers = _letters(golds, answers), _letters(answers, golds)
        if len(golds) > _MAX_PARTS or len(answers) > _MAX_PARTS:
            return False
        # Bare answers to a = 2, b = 3 stand in that order, unless names tell, or name one thing.
        names = {re.sub(r"_.*", "", item.name) for item in golds if isinstance(item, Equality) and item.name}
        unnamed = not any(isinstance(item, Equality) for item in answers)
        if unnamed and len(answers) == len(golds) == len(names) > 1:
            return self.in_order(golds, answers)
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

    def named_parts(self, ordered: Parts, several: Parts) -> bool:
        """Compare (1, 2) with 1, 2, or with x = 1, y = 2: the names in the order of the alphabet."""
        items = several.items
        values = [item for item in items if isinstance(item, Equality) and item.name]
        if several.kind == "set" or len(items) < 2:
            return len(items) == 1 and self.same(ordered, items[0])
        if len(values) == len(items) == len({item.name for item in values}):
            items = tuple(item.value for item in sorted(values, key=lambda item: item.name))
        elif values or any(isinstance(item, Leaf) and "infty" in item.text for item in ordered.items):
            return False
        return ordered.kind == "()" and self.in_order(ordered.items, items)

    def distinct(self, items: Sequence[Form]) -> tuple[Form, ...]:
        """Leave out what is there twice."""
        kept: list[Form] = []
        for item in items:
            if not any(self.same(other, item) for other in kept):
                kept.append(item)
        return tuple(kept)

    def matched(self, golds: Sequence[Form], answers: Sequence[Form]) -> bool:
        """Whether each gold part has an answer of its own."""
        return len(golds) == len(answers) == len(self.pairs(golds, answers))

    def pairs(self, golds: Sequence[Form], answers: Sequence[Form]) -> list[tuple[Form, Form]]:
        """Return the parts that are the same, each once; sameness is transitive, so the first that fits will do."""
        left, found = list(answers), []
        for gold in golds:
            index = next((index for index, answer in enumerate(left) if self.same_part(gold, answer)), None)
            if index is not None:
                found.append((gold, left.pop(index)))
        return found

    def same_part(self, gold: Form, answer: Form) -> bool:
        """Compare two parts of collections; there a set of one thing is not the thing."""
        sets = [isinstance(form, Parts) and form.kind == "set" for form in (gold, answer)]
        return sets[0] == sets[1] and self.same(gold, answer)

    def in_order(self, golds: Sequence[Form], answers: Sequence[Form]) -> bool:
        """Whether the parts are the same one by one."""
        return len(golds) == len(answers) and all(map(self.same, golds, answers))

    def cases(self, gold: Cases, answer: Cases) -> bool:
        """Compare values with conditions, in any order; one condition of either side may say 'otherwise'."""
        if len(gold.rows) != len(answer.rows):
            return False
        left, lone = list(answer.rows), []
        for row in gold.rows:
            found = next((index for index, other in enumerate(left) if self.rows(row, other)), None)
            if found is None:
                lone.append(row)
            else:
                del left[found]
        if len(lone) == len(left) == 1 and ["otherwise"] in [_words(lone[0][1]), _words(left[0][1])]:
            return self.same(lone[0][0], left[0][0])
        return not lone

    def rows(self, gold: Row, answer: Row) -> bool:
        """Compare two values with their conditions."""
        (value, condition), (other_value, other_condition) = gold, answer
        if condition is None or other_condition is None:
            return condition is other_condition and self.same(value, other_value)
        words = _words(condition)
        alike = words is not None and words == _words(other_condition)
        return (alike or self.same(condition, other_condition)) and self.same(value, other_value)

    def ratios(self, gold: Form, answer: Form) -> bool:
        """Compare ratios of numbers, 2:4 being 1:2, but no times of the clock."""
        if any(isinstance(form, Parts) and _CLOCK.match(form.text) for form in (gold, answer)):
            return False
        (first, *others), (first_answer, *other_answers) = (
            [self.factor(part) for part in _items(form)] for form in (gold, answer)
        )
        return (
            all([first, first_answer, *others, *other_answers])
            and len(others) == len(other_answers)
            and all(
                self.formulas(f"({one})({first_answer})", f"({other})({first})")
                for one, other in zip(others, other_answers, strict=True)
            )
        )

    def factor(self, form: Form) -> str:
        """Return the formula of a part of a ratio that is a number, and not zero; nothing of others."""
        plain = isinstance(form, Leaf) and form.base is None and not form.percent
        return form.text if isinstance(form, Leaf) and plain and self.parser.value(form.text) not in {None, 0} else ""

    def words(self, gold: Form, answer: Form) -> bool:
        """Compare words, letters and products; letters side by side may be either: RC is CR."""
        if letter_of(gold) is not None or not isinstance(gold, Words | Leaf) or not isinstance(answer, Words | Leaf):
            return letter_of(gold) is not None and letter_of(gold) == letter_of(answer)
        one, other = (
            form if isinstance(form, Words) else read_words(form.text) if form.unit is None else None
            for form in (gold, answer)
        )
        if one is not None and other is not None and one.words == other.words:
            return self.in_order(one.formulas, other.formulas) and (one.words != "" or one.text == other.text)
        first, second = (_product_of(form) if isinstance(form, Words) else form for form in (gold, answer))
        return first is not None and second is not None and self.leaves(first, second)

    def opaques(self, gold: Form, answer: Form) -> bool:
        """Compare what only sympy can read."""
        one, other = _text_of(gold), _text_of(answer)
        return bool(one and other) and self.formulas(one, other)

    def vectors(self, rows: Sequence[Form], group: Form) -> bool:
        """Compare a row or column, or a matrix in brackets, with a tuple."""
        if not isinstance(group, Parts) or group.kind not in {"()", "[]"}:
            return False
        cells = [_items(row) for row in rows]
        line = [row[0] for row in cells] if len(cells[0]) == 1 else cells[0] if len(cells) == 1 else None
        if line is not None and not any(isinstance(item, Parts) for item in group.items):
            return self.in_order(line, group.items)
        inner = [item.items for item in group.items if isinstance(item, Parts) and item.kind == "[]"]
        return (
            group.kind == "[]" and len(inner) == len(group.items) == len(rows) and all(map(self.in_order, cells, inner))
        )


def _bare(text: str) -> str:
    """Return a formula without white space, but for what keeps digits apart."""
    return re.sub(r"(?<!\d)\s+|\s+(?!\d)", "", text)


def letter_of(form: Form) -> str | None:
    """Return the letter that an answer to a multiple choice may consist of."""
    if isinstance(form, Leaf) and len(form.text) == 1 and form.text.isalpha():
        # Beyond J no choice goes: there small and capital letters differ.
        return form.text.upper() if form.text.upper() <= "J" else form.text
    if isinstance(form, Words) and len(form.words) == 1:
        return form.words.upper() if form.words <= "j" else form.words
    return None


def same_name(first: str, second: str) -> bool:
    """Return whether two names may name one thing: words name nothing that a formula needs, as in "Area = 5"."""
    one, other = sorted((first, second), key=len)
    if one == other or (one and re.fullmatch(re.escape(one) + r"\([A-Za-z](?:,[A-Za-z])*\)", other)):
        return True  # y is y(x)
    found = [_NAME_WORD.match(re.sub(r"\\(?:angle|triangle|measuredangle)", "", name)) for name in (first, second)]
    words = sorted((match[0].lower() for match in found if match is not None), key=len)
    return len(words) == 1 or (
        len(words) == 2 and (bool(set(words) & set(WORDS["any_name"])) or words[1].startswith(words[0]))
    )


def _renamed(name: str, answer: Equality) -> Form | None:
    """Return the value of g(x) = … in the variable of the name g(n); None where the names differ otherwise."""
    ours, theirs = _FUNCTION_NAME.match(name), _FUNCTION_NAME.match(answer.name)
    if ours is None or theirs is None or ours[1] != theirs[1] or answer.sides is None:
        return None
    tokens = re.findall(r"\\[a-zA-Z]+|.", answer.sides[1], re.DOTALL)
    if ours[2] in tokens:
        return None
    return read("".join(ours[2] if token == theirs[2] else token for token in tokens))


def _is_product(run: str) -> bool:
    """Whether a run of letters may be a product as well as a word."""
    return re.fullmatch(r"[A-Za-z]{2,4}", run) is not None and run.lower() not in WORDS["short_words"]


def _product_of(word: Words) -> Leaf | None:
    """Return the formula that words with letters side by side may be as well, as in abc/4R; None of true words."""
    text = word.text.strip()
    runs = re.findall(r"(?<![\\A-Za-z])[A-Za-z]{2,}", text)
    if not re.search("[A-Za-z]", text) or "\\text" in text or word.words.startswith("date "):
        return None
    alone = len(runs) == 1 and runs[0] == text
    return Leaf(text) if all(_is_product(run) and (alone or len(set(run)) == len(run)) for run in runs) else None


def _text_of(form: Form) -> str:
    """Return the LaTeX of a form that sympy may read; nothing of others."""
    if isinstance(form, Leaf):
        return form.text
    if isinstance(form, Opaque):
        return "" if form.has_words else form.text
    return form.text if isinstance(form, Parts) and form.kind == "matrix" else ""


def _words(condition: Form | None) -> list[str] | None:
    """Return what a condition says in words, without those that say nothing, as in 'n even' and 'n is even'."""
    return (
        [word for word in condition.words.split() if word not in WORDS["fillers"]]
        if isinstance(condition, Words)
        else None
    )


def _items(form: Form) -> tuple[Form, ...]:
    return form.items if isinstance(form, Parts) else (form,)


def _members(form: Form) -> tuple[Form, ...]:
    return form.items if isinstance(form, Parts) and form.kind in _UNORDERED else (form,)


def _letters(items: tuple[Form, ...], others: tuple[Form, ...]) -> tuple[Form, ...]:
    """Return the choices that letters name side by side, as ABD, beside others that name one each."""
    word = items[0] if len(items) == 1 < len(others) else None
    text = text_inside(word.text) if isinstance(word, Words | Leaf) else ""
    several = re.fullmatch("[A-J]+", text) and list(text) == sorted(set(text)) and None not in map(letter_of, others)
    return tuple(map(Leaf, text)) if several else items


def _named_parts(form: Form) -> Form:
    """Return (x, y) = (1, 2) as x = 1, y = 2, and x in {1, 2} as x = 1, x = 2."""
    if not isinstance(form, Equality) or not isinstance(form.value, Parts):
        return form
    names = form.name.strip("()").split(",")
    if form.value.kind in _UNORDERED:
        return Parts(form.value.kind, tuple(Equality(form.name, item) for item in form.value.items))
    if len(names) == len(form.value.items) > 1:
        return Parts("list", tuple(map(Equality, names, form.value.items)))
    return form
