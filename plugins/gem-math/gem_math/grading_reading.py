r"""Reads which form an answer has."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby, pairwise

from gem_math.grading_dates import date_of, time_of
from gem_math.grading_forms import (
    Assignment,
    Choice,
    Congruence,
    Equation,
    Form,
    Group,
    Inequality,
    Leaf,
    Many,
    Opaque,
    Ratio,
    Union,
    Words,
)
from gem_math.grading_intervals import (
    MINUS_INFINITY,
    PLUS_INFINITY,
    REAL_LINE,
    between,
    distance,
    exact_of_leaf,
    half_line,
    union_of,
)
from gem_math.grading_quantities import NUMBER_WORDS, read_compound, read_quantity
from gem_math.grading_tables import read_table
from gem_math.grading_text import words_of
from gem_math.grading_tokens import (
    UnreadableError,
    has_no_brackets,
    has_words,
    is_name,
    outer_brackets,
    plain_brackets,
    plain_name,
    sides_of,
    split,
    text_inside,
    walk,
)
from gem_math.grading_units import read_unit

_MAX_ITEMS = 200
_MAX_NESTING = 12
_LEAD = re.compile(
    r"(?i)^(?:so|thus|hence|therefore)?[\s,]*(?:the\s+)?(?:final\s+|correct\s+)?(?:answer|result|solution)s?\s*"
    r"(?:is|are|:|=)\s*:?\s*(?=\S)"
)
_STRANGE = {
    r"\to", r"\mapsto", r"\equiv", r"\sim", r"\propto", r"\cong", r"\notin", r"\subset", r"\subseteq", r"\Rightarrow",
    r"\implies", r"\iff", r"\rightarrow", r"\longrightarrow", r"\mid", r"\nmid", r"\parallel", r"\perp", r"\land",
    r"\wedge", r"\forall", r"\exists", r"\cap", r"\supset", r"\leftrightarrow", r"\Leftrightarrow", r"\pmod", r"\mod",
    r"\ldots", r"\not",
}  # fmt: skip
_OR = re.compile(r"(?<![A-Za-z])or(?![A-Za-z])|\\vee")
_SEPARATORS = {",", ";", "and", "or", r"\vee"}
_BRACKETS = set("()[]{}")
_NO_VALUE = {"dne", "does not exist", "the limit does not exist", "it does not exist"}
_NOTHING = {
    "no solution", "no solutions", "none", "empty set", "the empty set", "no real solution", "no real solutions",
    "there is no solution", "there are no solutions", "no such solution",
}  # fmt: skip
_ENDLESS = {
    "infinitely many", "infinitely many solutions", "infinite", "infinite solutions", "infinite number of solutions",
    "an infinite number of solutions", "there are infinitely many", "there are infinitely many solutions",
}  # fmt: skip
_REALS = {r"\mathbb{R}", "all real numbers", "all reals", "the real numbers", "all real x", "real numbers"}
_DIFFERENCE = re.compile(r"(?<![A-Za-z])[A-Za-z]\s*-\s*[A-Za-z](?![A-Za-z])|^\s*-\s*[A-Za-z](?![A-Za-z])")
_ARTICLE = re.compile(r"^(?:an|the) (?=\w{2})|^a (?=\w{3})")
_QUANTITY_IN_TEXT = re.compile(r"^\\text\s*\{\s*(-?\d+(?:\.\d+|/\d+)?)\s+([A-Za-z][A-Za-z /.^\d]*)\}$")
_TO = re.compile(r"(\d+)\s*(?:to|\\text\s*\{\s*to\s*\})\s*(\d+)")
_BUILDER = re.compile(r"^\s*([A-Za-z])\s*(?:\\in\s*\\mathbb\s*\{R\}\s*)?(?:\\mid|\||:)(.*)$", re.DOTALL)
_TIGHT_THOUSANDS = re.compile(r"(?<![\d.,])([1-9]\d{0,2}(?:,\d{3})+)(?![\d,])")
_NUMBER_WITH_COMMA = re.compile(r"^\s*-?\d+(?:,\d+)?\s*$")
_SPACED_THOUSANDS = re.compile(r"(?<![\d.,])(\d{1,3}(?: \d{3})+)(?![\d,])")
_CHOICE = re.compile(
    r"^(?:(?i:option|choice|answer)\s*)?(?:\(\s*([A-Za-z])\s*\)|([A-Z])\s*[.):](?=\s|$|\())\s*(.*)$", re.DOTALL
)
_CHOICE_WORD = re.compile(r"^(?i:option|choice)\s*\(?([A-Za-z])\)?$")

_MOD_IN_TEXT = re.compile(r"\\text\s*\{([^{}]*(?<![a-z])mod(?:ulo)?(?![a-z])[^{}]*)\}")
_MODULO = re.compile(
    r"(.*?)\(?\s*\\?(?<![a-z])mod(?:ulo)?(?![a-z])\s*(?:\{([^{}]+)\}|([^{}(),;]+?))\s*\)?\s*", re.DOTALL
)


def read(text: str, *, join_thousands: bool = True, loose_units: bool = False) -> Form:
    """Return the form of an answer.

    Args:
        text: The answer, after ``clean``.
        join_thousands: Read 1,234 as one number, not two.
        loose_units: Take a single letter behind a number for a unit where it can be one, as in 5 m.
    """
    try:
        return _Reading(join_thousands, loose_units).read(plain_brackets(text), 0)
    except (UnreadableError, RecursionError):
        return Opaque(text, has_words=True, unreadable=True)


class _Reading:
    """One reading of an answer, with its options."""

    def __init__(self, join_thousands: bool, loose_units: bool) -> None:
        self.join_thousands = join_thousands
        self.loose_units = loose_units
        self.items = 0

    def read(self, text: str, depth: int) -> Form:
        self.items += 1
        if depth > _MAX_NESTING or self.items > _MAX_ITEMS:
            raise UnreadableError
        text = _without_lead(text.strip())
        return (
            self.choice(text, depth) or self.words(text, depth) or self.several(text, depth) or self.single(text, depth)
        )

    def words(self, text: str, depth: int) -> Form | None:
        """What has no mathematics in it."""
        words = words_of(text)
        if (meant := _meant_by(text, words)) is not None:
            return meant
        rest = re.sub(r"\\text\s*\{[^{}]*\}", " ", text)
        if (
            rest != text
            and not rest.strip(" .,:;!?'\"-()")
            and re.fullmatch(r"[-+.,\d\s]+", inside := text_inside(text))
        ):
            return self.read(inside, _MAX_NESTING)
        if re.search(r"[\d\\+*/=<>^_|:$]", rest) or _DIFFERENCE.search(rest) or re.search(r"\\text\s*\{[^{}]*\d", text):
            return None
        if words in _NO_VALUE:
            return Words("does not exist", text)
        if words in {"infinity", "positive infinity", "negative infinity"}:
            return MINUS_INFINITY if "negative" in words else PLUS_INFINITY
        if words in NUMBER_WORDS:
            return Leaf(str(NUMBER_WORDS[words]))
        letters = rest.strip(" .,:;!?'\"-()[]{}")
        if rest == text and (len(letters) <= 1 or split(text, {",", ";"}) != [text]):
            return None
        if re.fullmatch(r"\\text\s*\{[^{}]*\}", text) and split(inside := text_inside(text), _SEPARATORS) != [inside]:
            return self.read(inside, depth + 1)
        separated = re.search(r"(?:^|\W)(?:and|or)(?:\W|$)|[,;]", text) is not None
        return None if separated or not words else Words(_ARTICLE.sub("", words), text)

    def choice(self, text: str, depth: int) -> Form | None:
        """A letter of a multiple choice."""
        flat = re.sub(r"\\text\s*\{\s*(\(?[A-Za-z][).:]*\)?)\s*\}", r"\1 ", text).strip()
        flat = re.sub(r"^\\text\s*\{\s*((?:[Oo]ption|[Cc]hoice)\s*\(?[A-Za-z]\)?)\s*\}$", r"\1", flat)
        flat = re.sub(r"^\\text\s*\{\s*(\(?[A-Z][).:])\s+([^{}]+)\}$", r"\1 \\text{\2}", flat)
        if match := _CHOICE_WORD.match(flat):
            return Choice(match[1].upper(), None)
        match = _CHOICE.match(flat)
        if match is None or (match[3] and match[3][0] in "+-*/^_=<>!,&"):
            return None
        rest = match[3].strip(" :.")
        if rest and match[1] and match[1].islower():
            return None  # (x) 2 may be a product
        return Choice((match[1] or match[2]).upper(), self.read(rest, depth + 1) if rest else None)

    def several(self, text: str, depth: int) -> Form | None:
        """Answers side by side."""
        if self.join_thousands:
            text = _without_commas(text)
            text = _SPACED_THOUSANDS.sub(lambda match: match[1].replace(" ", ""), text)
        if (compound := read_compound(text)) is not None:
            return compound
        if (points := self.points(text, depth)) is not None:
            return points
        if "mod" in text and (congruence := self.congruence(text, depth)) is not None:
            return congruence
        pieces = split(text, _SEPARATORS)
        pieces = [piece for piece in pieces if piece.strip()]
        if len(pieces) < 2:
            return (
                None
                if len(pieces) == 1 and pieces[0] == text
                else (self.read(pieces[0], depth + 1) if pieces else Words("", ""))
            )
        items: list[Form] = []
        for piece in pieces:
            item = self.read(piece, depth + 1)
            items.extend(item.items if isinstance(item, Many) and not item.is_set else [item])
        if (interval := between(items)) is not None and not _OR.search(text):
            return interval
        ranges = union_of(items) if " and " not in text and r"\text{ and }" not in text else None
        return ranges or Many(tuple(items))

    def congruence(self, text: str, depth: int) -> Form | None:
        r"""One or several residues, as in x \\equiv 1, 5 (mod 6)."""
        match = _MODULO.fullmatch(_MOD_IN_TEXT.sub(r"\1", text))
        if match is None or "mod" in match[1] + (match[3] or ""):
            return None
        sides = [side for side in re.split(r"\\equiv|=", match[1]) if side.strip()]
        if not sides:
            return None
        name = plain_name(sides[0]) if len(sides) == 2 and is_name(sides[0]) else ""
        modulus, found = self.read(match[2] or match[3], depth + 1), self.read(sides[-1], depth + 1)
        several = isinstance(found, Many)
        items = found.items if isinstance(found, Many) else (found,)
        forms = tuple(Congruence(name, item, _least(item, modulus), modulus) for item in items)
        return Many(forms) if several else forms[0]

    def points(self, text: str, depth: int) -> Form | None:
        """Points whose coordinates are named, as in x = 1, y = 2 or x = 3, y = 4."""
        if text.count("=") < 4:
            return None
        pieces = [piece for piece in split(text, {";", "or", r"\vee"}) if piece.strip()]
        if len(pieces) < 2 or not all("=" in piece and split(piece, {",", "and"}) != [piece] for piece in pieces):
            return None
        points: list[Form] = []
        for piece in pieces:
            form = self.read(piece, depth + 1)
            items = form.items if isinstance(form, Many) and not form.is_set else ()
            named = {item.name: item.value for item in items if isinstance(item, Assignment)}
            if not 1 < len(named) == len(items):
                return None
            points.append(Group("(", tuple(named[name] for name in sorted(named)), ")"))
        return Many(tuple(points))

    def single(self, text: str, depth: int) -> Form:
        if self.join_thousands:
            text = _SPACED_THOUSANDS.sub(lambda match: match[1].replace(" ", ""), text)
            text = _without_commas(text)
        if (time := time_of(text)) is not None:
            return Words(time, text)
        if (quantity := _QUANTITY_IN_TEXT.match(text)) and read_unit(quantity[2]) is not None:
            return read_quantity(rf"{quantity[1]} \text{{{quantity[2]}}}")
        if text.startswith(r"\{") and (form := self.bracketed(text, depth)) is not None:
            return form
        if r"\pm" in text or r"\mp" in text:
            if re.match(r"^\s*\\pm\s*\\infty\s*$", text):
                return Many((PLUS_INFINITY, MINUS_INFINITY))
            above = text.replace(r"\pm", "+").replace(r"\mp", "-")
            below = text.replace(r"\pm", "-").replace(r"\mp", "+")
            return Many(tuple(self.flat([_signs(above), _signs(below)], depth)))
        for attempt in (self.relation, self.union, self.bracketed, self.table, self.ratio):
            form = attempt(text, depth)
            if form is not None:
                return form
        if any(token in _STRANGE for token, level in walk(text) if level == 0):
            return Opaque(text, has_words(text))
        return read_quantity(text, loose_units=self.loose_units)

    def flat(self, texts: list[str], depth: int) -> Iterator[Form]:
        for text in texts:
            item = self.read(text, depth + 1)
            yield from item.items if isinstance(item, Many) and not item.is_set else [item]

    def relation(self, text: str, depth: int) -> Form | None:
        approximate = split(text, {r"\approx"})
        if len(approximate) > 1:
            first = approximate[0].strip()
            if not first or is_name(first):
                return self.read("=".join([first, approximate[1]]) if first else approximate[1], depth + 1)
            return self.read(first, depth + 1)
        sides, signs = sides_of(text)
        if not signs:
            return None
        if not all(side.strip() for side in sides):
            if len(sides) == 2 and signs == ["="] and not sides[0].strip():
                return self.read(sides[1], depth + 1)
            raise UnreadableError
        if set(signs) == {"="}:
            return self.equalities(sides, depth)
        if signs == ["in"]:
            if not is_name(sides[0]):
                raise UnreadableError
            value = self.read(sides[1], depth + 1)
            if isinstance(value, Group | Union):
                return Inequality(plain_name(sides[0]), value)
            return Assignment(plain_name(sides[0]), value)
        form = self.range(sides, signs, depth)
        return Opaque(text, has_words(text)) if form is None else Inequality(form.name, form.values, text)

    def equalities(self, sides: list[str], depth: int) -> Form:
        name, *others = sides
        value = self.read(others[-1], depth + 1)
        if isinstance(value, Many) and len(others) == 1 and not value.is_set and is_name(name):
            return Many(tuple(Assignment(plain_name(name), item) for item in value.items))
        steps = tuple(self.read(side, depth + 1) for side in others[:-1])
        if is_name(name) or name.strip() in {"i", "e"}:
            return Assignment(plain_name(name), value, steps, name, others[-1])
        return Equation(name, others[-1], value, (self.read(name, depth + 1), *steps))

    def range(self, sides: list[str], signs: list[str], depth: int) -> Inequality | None:
        """The interval that an inequality of one variable describes."""
        turned = {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "!=": "!="}
        if any(sign not in turned for sign in signs):
            return None
        if len(sides) == 2 and (form := distance(sides, signs[0], lambda side: self.read(side, depth + 1))) is not None:
            return form
        if len(sides) == 2:
            if is_name(sides[1]) and not is_name(sides[0]):
                sides, signs = sides[::-1], [turned[signs[0]]]
            if not is_name(sides[0]) or is_name(sides[1]):
                return None
            return Inequality(plain_name(sides[0]), half_line(signs[0], self.read(sides[1], depth + 1)))
        if len(sides) == 3 and is_name(sides[1]):
            if set(signs) <= {">", ">="}:
                sides, signs = sides[::-1], [turned[sign] for sign in signs[::-1]]
            if set(signs) <= {"<", "<="}:
                low, high = self.read(sides[0], depth + 1), self.read(sides[2], depth + 1)
                brackets = ("(" if signs[0] == "<" else "["), (")" if signs[1] == "<" else "]")
                return Inequality(plain_name(sides[1]), Group(brackets[0], (low, high), brackets[1]))
        return None

    def union(self, text: str, depth: int) -> Form | None:
        parts = split(text, {r"\cup"})
        if len(parts) > 1:
            read = tuple(self.read(part, depth + 1) for part in parts)
            sets = [part for part in read if isinstance(part, Many) and part.is_set]
            if len(sets) == len(read):
                return Many(tuple(item for part in sets for item in part.items), is_set=True)
            return Union(read)
        parts = split(text, {r"\setminus", r"\backslash"})
        if len(parts) == 2 and parts[0].strip() in {r"\mathbb{R}", r"(-\infty,\infty)", r"(-\infty, \infty)"}:
            holes = self.read(parts[1], depth + 1)
            values = [exact_of_leaf(hole) for hole in holes.items] if isinstance(holes, Many) else [None]
            if values and None not in values:
                points = [Leaf(str(value)) for value in sorted(value for value in values if value is not None)]
                bounds = [MINUS_INFINITY, *points, PLUS_INFINITY]
                return Union(tuple(Group("(", pair, ")") for pair in pairwise(bounds)))
        return Opaque(text) if len(parts) > 1 else None

    def bracketed(self, text: str, depth: int) -> Form | None:
        found = outer_brackets(text)
        if found is None:
            return None
        opening, inner, closing = found
        if opening == r"\{":
            if (builder := _BUILDER.match(inner)) and is_name(builder[1]):
                condition = self.read(builder[2], depth + 1)
                return condition if isinstance(condition, Inequality) else Opaque(text, has_words(text))
            if closing != r"\}" or any(token in {"|", ":", r"\mid"} for token, level in walk(inner) if level == 0):
                return Opaque(text, has_words(text))
            items = [piece for piece in split(self.joined(inner), {",", ";"}) if piece.strip()]
            return Many(tuple(self.flat(items, depth)), is_set=True)
        if opening == "{":
            return self.read(inner, depth + 1)
        if opening not in {"(", "[", r"\langle"}:
            return None
        pieces = split(self.joined(inner), {",", ";"})
        if len(pieces) == 1:
            return self.read(inner, depth + 1) if (opening, closing) in {("(", ")"), ("[", "]")} else None
        items = [piece for piece in pieces if piece.strip()]
        if len(items) != len(pieces):
            raise UnreadableError
        opening, closing = ("(", ")") if opening == r"\langle" else (opening, closing)
        return Group(opening, tuple(self.read(item, depth + 1) for item in items), closing)

    def joined(self, inner: str) -> str:
        """Join thousands between brackets only where the commas with a space show which are separators."""
        pieces = split(inner, {";"})
        # (0,5; 2) has decimal commas: its separator is another one.
        if len(pieces) > 1 and any("," in piece for piece in pieces) and all(map(_NUMBER_WITH_COMMA.match, pieces)):
            return inner.replace(",", ".")
        if not self.join_thousands or not re.search(r"[,;]\s", inner):
            return inner
        return _TIGHT_THOUSANDS.sub(lambda match: match[1].replace(",", ""), inner)

    def table(self, text: str, depth: int) -> Form | None:
        return read_table(text, lambda cell: self.read(cell, depth + 1))

    def ratio(self, text: str, depth: int) -> Form | None:
        if match := _TO.fullmatch(text_inside(text)):
            text = f"{match[1]}:{match[2]}"
        parts = split(text, {":"})
        if len(parts) < 2:
            return None
        if not all(part.strip() for part in parts):
            raise UnreadableError
        return Ratio(tuple(self.read(part, depth + 1) for part in parts), text.replace(" ", ""))


def _meant_by(text: str, words: str) -> Form | None:
    """Return what some answers in words mean: nothing, every number, infinity, a day."""
    if text in {r"\emptyset", r"\{\}", r"\{ \}"} or words in _NOTHING:
        return Many((), is_set=True)
    if text.strip() in _REALS or words in _REALS:
        return REAL_LINE
    if words in _ENDLESS:
        return PLUS_INFINITY
    date = date_of(text_inside(text)) if words[:1].isalnum() else None
    return None if date is None else Words(date, text)


def _without_commas(text: str) -> str:
    """Join thousands that stand outside brackets; between these commas separate."""
    if has_no_brackets(text):
        return _TIGHT_THOUSANDS.sub(lambda match: match[1].replace(",", ""), text)
    return "".join(
        _TIGHT_THOUSANDS.sub(lambda match: match[1].replace(",", ""), "".join(token for token, _ in tokens))
        if outside
        else "".join(token for token, _ in tokens)
        for outside, tokens in groupby(walk(text), key=lambda token: token[1] == 0 and token[0] not in _BRACKETS)
    )


def _without_lead(text: str) -> str:
    if not re.match(
        r"(?i)\W*(?:text\s*\{)?\s*(?:so|thus|hence|therefore|the|final|correct|answer|result|solution)", text
    ):
        return text
    flat = re.sub(r"^\\text\s*\{([^{}]*)\}", r"\1 ", text)
    found = _LEAD.match(flat)
    return flat[found.end() :].strip() if found else text


def _least(residue: Form, modulus: Form) -> Form:
    """Return the residue from 0 on, where both are whole numbers."""
    value, base = exact_of_leaf(residue), exact_of_leaf(modulus)
    if value is None or not base or value.denominator != 1:
        return residue
    return Leaf(str(value % abs(base)))


def _signs(text: str) -> str:
    return re.sub(r"^\s*\+", "", re.sub(r"([=(,<>]\s*)\+", r"\1", text))
