r"""Reads which form an answer has: a quantity, list, set, tuple, interval, relation, matrix, choice, or words."""

from __future__ import annotations

import re
from collections.abc import Callable

from gem_math.grading.arithmetic import number_of
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
    spread,
)
from gem_math.grading.quantities import NUMBERS, Leaf, read_compound, read_quantity, without_dots
from gem_math.grading.text import (
    UnreadableError,
    has_words,
    is_name,
    outer_brackets,
    plain_brackets,
    plain_name,
    sides_of,
    split,
    text_inside,
    walk,
    worded,
    words_of,
)
from gem_math.grading.words import WORDS

_MAX_ITEMS = 200
_MAX_NESTING = 12
_LEAD = re.compile(
    r"(?i)^(?:so|thus|hence|therefore)?[\s,]*(?:the\s+)?(?:final\s+|correct\s+)?(?:answer|result|solution)s?\s*"
    r"(?:is|are|:|=)\s*:?\s*(?=\S)"
)
_OR = re.compile(r"(?<![A-Za-z])or(?![A-Za-z])|\\vee")
_SEPARATORS = {",", ";", "and", "or", r"\vee"}
_ENDLESS = re.compile(
    r"(?:there are )?infinitely many(?: solutions)?|infinite(?: solutions)?|(?:an )?infinite number of solutions"
)
_SIGNS_ALONE = re.compile(r"[^\w]+|\^.*")
# A hyphen has letters on both sides; any other is a minus.
_DIFFERENCE = re.compile(r"(?<![^\W\d_]{2})-|-(?![^\W\d_]{2})")
_ARTICLE = re.compile(r"^(?:an|the) (?=\w{2}|#)|^a (?=\w{3}|#)")
_FORMULA_IN_TEXT = re.compile(r"\\text\s*\{[^{}]*[\d+=<>]")
_QUANTITY_IN_TEXT = re.compile(r"^\\text\s*\{\s*(-?\d+(?:\.\d+|/\d+)?)\s+([A-Za-z][A-Za-z /.^\d]*)\}$")
_TO = re.compile(r"(\d+)\s*(?:to|\\text\s*\{\s*to\s*\})\s*(\d+)")
_BUILDER = re.compile(r"^\s*([A-Za-z])\s*(?:\\in\s*\\mathbb\s*\{R\}\s*)?(?:\\mid|\||:)(.*)$", re.DOTALL)
_TIGHT_THOUSANDS = re.compile(r"(?<![\d.,])([1-9]\d{0,2}(?:,\d{3})+)(?![\d,])")
_NUMBER_WITH_COMMA = re.compile(r"^\s*-?\d+(?:,\d+)?\s*$")
_SPACED_THOUSANDS = re.compile(r"(?<![\d.,])(\d{1,3}(?: \d{3})+)(?![\d,])")
_CHOICE = re.compile(
    r"^(?:(?i:option|choice|answer)\s*)?(?:\(\s*([A-Za-z])\s*\)|([A-Z])\s*[.):](?=\s|$|\())\s*(.*)$", re.DOTALL
)
_LABEL = re.compile(r"(?<![^\s,;])\(([a-h]|i{1,3}|iv|v)\)(?=\s)")
_CHOICE_WORD = re.compile(r"^(?i:option|choice)\s*\(?([A-Za-z])\)?$")
_MOD_IN_TEXT = re.compile(r"\\text\s*\{([^{}]*(?<![a-z])mod(?:ulo)?(?![a-z])[^{}]*)\}")
_MODULO = re.compile(
    r"(.*?)\(?\s*\\?(?<![a-z])mod(?:ulo)?(?![a-z])\s*(?:\{([^{}]+)\}|([^{}(),;]+?))\s*\)?\s*", re.DOTALL
)
_TIME = re.compile(r"(\d{1,2})(:\d\d)?\s*([ap])\.?\s?m\.?", re.IGNORECASE)
_DAY_IN_DIGITS = re.compile(r"(\d{4})-(\d\d)-(\d\d)")
_MATRIX = re.compile(r"^\\begin\s*\{([pbB]?matrix|smallmatrix|array)\}(?:\s*\{[^{}]*\})?(.*)\\end\s*\{\1\}$", re.DOTALL)
_CASES = re.compile(r"^\\begin\s*\{([dr]?cases)\}(.*)\\end\s*\{\1\}$", re.DOTALL)
_ROW_END = re.compile(r"\\\\(?:\s*\[[^\]]*\])?|\\cr(?![a-zA-Z])")
_TRANSPOSED = re.compile(r"^(.*)\^\s*(?:\{\s*)?(?:T|\\top|\\intercal|\\text\s*\{\s*T\s*\})(?:\s*\})?$", re.DOTALL)
_CONDITION_WORD = re.compile(r"^\s*(?:\\text\s*\{\s*(?:if|for|when|where)\s*\}|(?:if|for|when|where)(?![A-Za-z]))")

PLUS_INFINITY, MINUS_INFINITY = Leaf(r"\infty"), Leaf(r"-\infty")


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
        return Opaque(text, has_words=True)


def read_words(text: str) -> Words | None:
    """Return an answer as words with formulas among them; None where it has no words."""
    return _Reading(True, False).worded(text, 0)


class _Reading:
    """One reading of an answer, with its options; each method returns None for what has another form."""

    def __init__(self, join_thousands: bool, loose_units: bool) -> None:
        self.join_thousands = join_thousands
        self.loose_units = loose_units
        self.items = 0

    def read(self, text: str, depth: int) -> Form:
        self.items += 1
        if depth > _MAX_NESTING or self.items > _MAX_ITEMS:
            raise UnreadableError
        text = without_dots(_without_lead(text.strip()))
        if self.join_thousands:
            text = _without_commas(_SPACED_THOUSANDS.sub(lambda match: match[1].replace(" ", ""), text))
        forms = (attempt(self, text, depth) for attempt in FORMS.values())
        return next((form for form in forms if form is not None), Opaque(text))

    def words(self, text: str, depth: int) -> Form | None:
        """What has no mathematics in it."""
        words = words_of(text)
        if (meant := _meant_by(text, words)) is not None:
            return meant
        rest = re.sub(r"\\text\s*\{[^{}]*\}", " ", text)
        inside = text_inside(text)
        if rest != text and not rest.strip(" .,:;!?'\"-()") and re.fullmatch(r"[-+.,\d\s]+", inside):
            return self.read(inside, _MAX_NESTING)
        if (
            re.search(r"[\d\\+*/=<>^_|:$]", rest)
            or _DIFFERENCE.search(f"{inside} {rest}")
            or re.search(r"\\text\s*\{[^{}]*[\d+=<>]", text)
        ):
            return None
        if words in NUMBERS:
            return Leaf(str(NUMBERS.index(words)))
        letters = rest.strip(" .,:;!?'\"-()[]{}")
        if rest == text and (len(letters) <= 1 or split(text, {",", ";"}) != [text]):
            return None
        if re.fullmatch(r"\\text\s*\{[^{}]*\}", text) and split(inside, _SEPARATORS) != [inside]:
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
        if [match[1] for match in _LABEL.finditer(flat)][:2] in (["a", "b"], ["i", "ii"]) and flat[0] == "(":
            parts = _LABEL.split(flat)[1:]  # a label, what stands behind it, and so on
            rests = (self.read(rest.strip(" ,;.:"), depth + 1) for rest in parts[1::2])
            return Parts("list", tuple(map(Choice, map(str.upper, parts[::2]), rests)))
        match = _CHOICE.match(flat)
        if match is None or (match[3] and match[3][0] in "+-*/^_=<>!,&"):
            return None
        rest = match[3].strip(" :.")
        if rest and match[1] and match[1].islower():
            return None  # (x) 2 may be a product
        if any(_CHOICE.match(piece.strip()) for piece in split(rest, _SEPARATORS)[1:]):
            return None  # A: 1, B: 3 has two labels
        return Choice((match[1] or match[2]).upper(), self.read(rest, depth + 1) if rest else None)

    def several(self, text: str, depth: int) -> Form | None:
        """Answers side by side."""
        pieces = [piece for piece in split(text, _SEPARATORS) if piece.strip()]
        if len(pieces) < 2:
            return None if pieces == [text] else self.read(pieces[0], depth + 1) if pieces else Words("", "")
        return Parts("or" if _OR.search(text) else "list", self.flat(pieces, depth))

    def congruence(self, text: str, depth: int) -> Form | None:
        r"""One or several residues, as in x \\equiv 1, 5 (mod 6)."""
        match = _MODULO.fullmatch(_MOD_IN_TEXT.sub(r"\1", text)) if "mod" in text else None
        if match is None or "mod" in match[1] + (match[3] or ""):
            return None
        sides = [side for side in re.split(r"\\equiv|=", match[1]) if side.strip()]
        if not sides:
            return None
        name = plain_name(sides[0]) if len(sides) == 2 and is_name(sides[0]) else ""
        modulus, found = self.read(match[2] or match[3], depth + 1), self.read(sides[-1], depth + 1)
        forms = tuple(Congruence(name, item, _least(item, modulus), modulus) for item in spread(found))
        return Parts("list", forms) if len(forms) > 1 else forms[0]

    def points(self, text: str, depth: int) -> Form | None:
        """Points whose coordinates are named, as in x = 1, y = 2 or x = 3, y = 4."""
        pieces = [piece for piece in split(text, {";", "or", r"\vee"}) if piece.strip()] if text.count("=") > 3 else []
        if len(pieces) < 2 or not all("=" in piece and split(piece, {",", "and"}) != [piece] for piece in pieces):
            return None
        points: list[Form] = []
        for piece in pieces:
            items = spread(self.read(piece, depth + 1))
            named = {item.name: item.value for item in items if isinstance(item, Equality) and item.name}
            if not 1 < len(named) == len(items):
                return None
            points.append(Parts("()", tuple(named[name] for name in sorted(named))))
        return Parts("list", tuple(points))

    def quantity(self, text: str, depth: int) -> Form | None:
        """A number or formula, with its unit, all of which may stand in a text."""
        inside = _QUANTITY_IN_TEXT.match(text)
        leaf = read_quantity(rf"{inside[1]} \text{{{inside[2]}}}") if inside else None
        return leaf or read_quantity(text, loose_units=self.loose_units)

    def braces(self, text: str, depth: int) -> Form | None:
        """A set, whatever signs stand in it."""
        return self.bracketed(text, depth) if text.startswith(r"\{") else None

    def plus_or_minus(self, text: str, depth: int) -> Form | None:
        if r"\pm" not in text and r"\mp" not in text:
            return None
        above = text.replace(r"\pm", "+").replace(r"\mp", "-")
        below = text.replace(r"\pm", "-").replace(r"\mp", "+")
        both = self.flat([_signs(above), _signs(below)], depth)
        return Opaque(text) if any(isinstance(form, Inequality) for form in both) else Parts("list", both)

    def worded(self, text: str, depth: int) -> Words | None:
        """Words, and the formulas among them."""
        words, formulas = worded(text)
        if words == "#":
            return None
        return Words(_ARTICLE.sub("", words), text, tuple(self.formula(formula, depth) for formula in formulas))

    def formula(self, text: str, depth: int) -> Form:
        """A formula among words; what is none, as a sign alone, is compared as it is written."""
        try:
            return Opaque(text) if _SIGNS_ALONE.fullmatch(text) else self.read(text, depth + 1)
        except UnreadableError:
            return Opaque(text)

    def flat(self, texts: list[str], depth: int) -> tuple[Form, ...]:
        return tuple(item for text in texts for item in spread(self.read(text, depth + 1)))

    def relation(self, text: str, depth: int) -> Form | None:
        """Equations, inequalities, membership, and what is about equal."""
        approximate = split(text, {r"\approx"})
        if len(approximate) > 1:
            first = approximate[0].strip()
            if not first or is_name(first):
                return self.read("=".join([first, approximate[1]]) if first else approximate[1], depth + 1)
            return self.read(first, depth + 1)
        sides, signs = sides_of(text)
        if not signs:
            return None
        if set(signs) == {"="}:
            return self.equalities(sides, depth)
        if signs == ["in"]:
            if not is_name(sides[0]):
                raise UnreadableError
            return Equality(plain_name(sides[0]), self.read(sides[1], depth + 1))
        return _inequality(sides, signs, text) or Opaque(text, has_words(text))

    def equalities(self, sides: list[str], depth: int) -> Form:
        name, *others = sides
        value = self.read(others[-1], depth + 1)
        steps = tuple(self.read(side, depth + 1) for side in others[:-1])
        named = is_name(name) or name.strip() in {"i", "e"}
        steps = steps if named else (self.read(name, depth + 1), *steps)
        return Equality(plain_name(name) if named else "", value, steps, (name, others[-1]))

    def union(self, text: str, depth: int) -> Form | None:
        """Sets put together, and the real numbers without some."""
        parts = split(text, {r"\cup"})
        if len(parts) > 1:
            read = [self.read(part, depth + 1) for part in parts]
            if all(isinstance(part, Parts) and part.kind == "set" for part in read):
                return Parts("set", tuple(item for part in read if isinstance(part, Parts) for item in part.items))
            return Parts("union", tuple(read))
        parts = split(text, {r"\setminus", r"\backslash"})
        if len(parts) == 2 and re.sub(r"\s", "", parts[0]) in {r"\mathbb{R}", r"(-\infty,\infty)"}:
            holes = split(parts[1].replace(r"\{", "").replace(r"\}", ""), {","})
            return Inequality(("x", *holes), ("!=",) * len(holes), text)
        return Opaque(text) if len(parts) > 1 else None

    def bracketed(self, text: str, depth: int) -> Form | None:
        found = outer_brackets(text)
        if found is None:
            return None
        opening, inner, closing = found
        if opening == r"\{":
            if (builder := _BUILDER.match(inner)) and is_name(builder[1]):
                condition = self.read(builder[2], depth + 1)
                return condition if isinstance(condition, Inequality | Parts) else Opaque(text, has_words(text))
            if closing != r"\}" or any(token in {"|", ":", r"\mid"} for token, level in walk(inner) if level == 0):
                return Opaque(text, has_words(text))
            items = [piece for piece in split(self.with_points(inner), {",", ";"}) if piece.strip()]
            return Parts("set", self.flat(items, depth))
        if opening == "{":
            return self.read(inner, depth + 1)
        if opening not in {"(", "[", r"\langle"}:
            return None
        pieces = split(self.with_points(inner), {",", ";"})
        if len(pieces) == 1:
            return self.read(inner, depth + 1) if (opening, closing) in {("(", ")"), ("[", "]")} else None
        if not all(piece.strip() for piece in pieces):
            raise UnreadableError
        brackets = "()" if opening == r"\langle" else opening + closing
        return Parts(brackets, tuple(self.read(item, depth + 1) for item in pieces))

    def with_points(self, inner: str) -> str:
        """Write decimal commas between brackets as points."""
        pieces = split(inner, {";"})
        # (0,5; 2) has decimal commas: its separator is another one.
        if len(pieces) > 1 and any("," in piece for piece in pieces) and all(map(_NUMBER_WITH_COMMA.match, pieces)):
            return inner.replace(",", ".")
        return inner

    def table(self, text: str, depth: int) -> Form | None:
        """A matrix, a transposed one, or values with conditions."""
        if match := _TRANSPOSED.match(text):
            body = match[1].strip()
            return _transposed(self.read(body, depth + 1)) if body[-1:] in {")", "]", "}"} else None
        found = outer_brackets(text)
        inner = found[1].strip() if found is not None and found[0] in {"(", "["} else text
        if match := _CASES.match(inner):
            return self.cases(match[2], depth)
        match = _MATRIX.match(inner)
        if match is None or r"\begin" in match[2]:
            return Opaque(text, has_words(text)) if r"\begin" in text else None
        rows = [row for row in _ROW_END.split(match[2].replace(r"\hline", "")) if row.strip()]
        cells = [Parts("row", tuple(self.read(cell, depth + 1) for cell in row.split("&"))) for row in rows]
        if len({len(row.items) for row in cells}) != 1:
            raise UnreadableError
        return Parts("matrix", tuple(cells), text)

    def cases(self, body: str, depth: int) -> Form:
        """Values with conditions; equations without any are a list of them."""
        rows = [_row(row) for row in _ROW_END.split(body) if row.strip()]
        if not rows:
            raise UnreadableError
        if all(condition is None for _, condition in rows):
            return Parts("list", self.flat([value for value, _ in rows], depth))
        return Cases(tuple((self.read(value, depth + 1), self.condition(text, depth)) for value, text in rows))

    def condition(self, text: str | None, depth: int) -> Form | None:
        if text is None:
            return None
        if words_of(text) in {"otherwise", "else", "if otherwise"}:
            return Words("otherwise", text)
        text = text_inside(text) if re.fullmatch(r"\\text\s*\{[^{}]*\}", text) else text
        return self.read(_CONDITION_WORD.sub("", text).strip(" ,.;"), depth + 1)

    def ratio(self, text: str, depth: int) -> Form | None:
        if match := _TO.fullmatch(text_inside(text)):
            text = f"{match[1]}:{match[2]}"
        parts = split(text, {":"})
        if len(parts) < 2:
            return None
        if not all(part.strip() for part in parts):
            raise UnreadableError
        return Parts("ratio", tuple(self.read(part, depth + 1) for part in parts), text.replace(" ", ""))


FORMS: dict[str, Callable[[_Reading, str, int], Form | None]] = {
    "choices": _Reading.choice,
    "words": _Reading.words,
    "quantities in several units": lambda reading, text, depth: read_compound(text),
    "points with named coordinates": _Reading.points,
    "congruences": _Reading.congruence,
    "several answers": _Reading.several,
    "times of day": lambda reading, text, depth: _time_of(text),
    "sets": _Reading.braces,
    "plus or minus": _Reading.plus_or_minus,
    "equations and inequalities": _Reading.relation,
    "unions": _Reading.union,
    "brackets": _Reading.bracketed,
    "matrices and cases": _Reading.table,
    "ratios": _Reading.ratio,
    "quantities": _Reading.quantity,
    "words with formulas": _Reading.worded,
}
"""Readings of one answer: the first that fits says what it is; scripts/grader_readings.py tries each."""


def _meant_by(text: str, words: str) -> Form | None:
    """Return what some answers in words mean: nothing, every number, infinity, a day."""
    if text in {r"\emptyset", r"\{\}", r"\{ \}"} or words in WORDS["no_solution"]:
        return Parts("set", ())
    if {text.strip(), words} & set(WORDS["reals"]):
        return Parts("()", (MINUS_INFINITY, PLUS_INFINITY))
    if _ENDLESS.fullmatch(words) or (words in {"infinity", "positive infinity"} and "\\infty" not in text):
        return PLUS_INFINITY
    if words == "negative infinity":
        return MINUS_INFINITY
    if words in WORDS["no_value"]:
        return Words("does not exist", text)
    date = _date_of(text_inside(text))
    return None if date is None else Words(date, text)


def _date_of(text: str) -> str | None:
    """Return a day as its month, day and year, whatever their order, as ``date july 4 2020``; None of anything else."""
    text = text.strip().lower()
    if (match := _DAY_IN_DIGITS.fullmatch(text)) and 0 < int(match[2]) < 13:
        text = f"{WORDS['months'][int(match[2]) - 1]} {int(match[3])} {match[1]}"
    text = re.sub(r"^on\s+|^(?:mon|tues|wednes|thurs|fri|satur|sun)day\b|\bthe\b|\bof\b|[.,^{}]", " ", text)
    words = re.sub(r"(?<=\d)\s*(?:st|nd|rd|th)\b", "", text).split()
    numbers = sorted((word for word in words if word.isdigit()), key=len)
    names = [word for word in words if not word.isdigit()]
    if len(names) != 1 or len(names[0]) < 3 or [len(number) for number in numbers] not in ([1], [2], [1, 4], [2, 4]):
        return None
    month = next((month for month in WORDS["months"] if month.startswith(names[0])), None)
    return month and " ".join(["date", month, *numbers])


def _time_of(text: str) -> Words | None:
    """Return a time before or after noon in one spelling."""
    match = _TIME.fullmatch(text_inside(text)) if text[-1:] in {"m", "M", ".", "}"} else None
    # 3am without any mark is a product.
    if match is None or not (match[2] or re.search(r"[\s.A-Z]|\\text", text)):
        return None
    return Words(f"{match[1]}{match[2] or ':00'} {match[3].lower()}m", text)


def _transposed(form: Form) -> Form | None:
    if not isinstance(form, Parts) or form.kind not in {"matrix", "()", "[]"}:
        return None
    rows = [row.items for row in form.items if isinstance(row, Parts)] if form.kind == "matrix" else [form.items]
    return Parts("matrix", tuple(Parts("row", column) for column in zip(*rows, strict=True)))


def _row(row: str) -> tuple[str, str | None]:
    value, mark, condition = row.partition("&")
    condition = condition.replace("&", " ").strip(" ,.;")
    return value.strip(" ,.;"), condition if mark and condition else None


def _without_commas(text: str) -> str:
    """Join thousands that stand outside brackets; between these commas separate."""

    def joined(match: re.Match[str]) -> str:
        before = text[: match.start()]
        inside = sum(map(before.count, "([{")) > sum(map(before.count, ")]}"))
        return match[0] if inside else match[0].replace(",", "")

    return _TIGHT_THOUSANDS.sub(joined, text)


def _without_lead(text: str) -> str:
    flat = re.sub(r"^\\text\s*\{([^{}]*)\}", r"\1 ", text)
    found = _LEAD.match(flat)
    return flat[found.end() :].strip() if found else text


def _inequality(sides: list[str], signs: list[str], text: str) -> Inequality | None:
    leaves = [leaf for side in sides if (leaf := read_quantity(side)) is not None and not leaf.percent]
    units = {leaf.unit for leaf in leaves if leaf.unit is not None and leaf.unit.measures}
    if len(leaves) < len(sides) or len(units) > 1:
        return None
    return Inequality(tuple(leaf.text for leaf in leaves), tuple(signs), text, *units)


def _least(residue: Form, modulus: Form) -> Form:
    """Return the residue from 0 on, where both are whole numbers."""
    value, base = (number_of(form.text) if isinstance(form, Leaf) else None for form in (residue, modulus))
    return residue if value is None or not base or value.denominator != 1 else Leaf(str(value % abs(base)))


def _signs(text: str) -> str:
    return re.sub(r"^\s*\+", "", re.sub(r"([=(,<>]\s*)\+", r"\1", text))
