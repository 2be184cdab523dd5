r"""Reads one quantity: a number or formula with its unit, currency, per cent sign or base of digits."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

from gem_math.grading.arithmetic import number_of
from gem_math.grading.text import has_words, text_inside, words_of
from gem_math.grading.words import WORDS


class Unit(NamedTuple):
    """What stands behind a number.

    Args:
        measures: Dimensions with their powers, as ``{("length", 2)}``; empty for what is counted.
        factor: How many of the dimension's base units one is.
        nouns: What is counted, in the singular; an answer may leave it out.
    """

    measures: frozenset[tuple[str, int]] = frozenset()
    factor: Fraction = Fraction(1)
    nouns: frozenset[str] = frozenset()


DEGREE = Unit(frozenset({("angle", 1)}))
RADIAN = Unit(frozenset({("radian", 1)}))
DOLLAR = Unit(frozenset({("dollar", 1)}))

_TABLE: dict[str, tuple[str, Fraction]] = {}
for _dimension, _names in WORDS["units"].items():
    for _line in _names.split("|"):
        _factor, *_spellings = _line.split()
        _TABLE.update(dict.fromkeys(_spellings, (_dimension, Fraction(_factor))))
_SINGLE = {"m", "s", "h", "g", "l", "L", "N", "J", "W"}
_PIECE = re.compile(r"[^\W\d_]+(?:'[a-z]+)?|\^\s*\{?\s*(-?\d)\s*\}?|/|(\S)")
_MAX_NOUNS = 4
_POWERS_BEFORE = {"square": 2, "sq": 2, "cubic": 3, "cu": 3}
_POWERS_BEHIND = {"squared": 2, "cubed": 3}
_ARTICLES = {"each", "a", "an"}


def read_unit(text: str) -> Unit | None:
    """Return the unit that a text names, as in ``square cm`` or ``km/h``; None where it is more than a unit."""
    text = re.sub(r"\\text\s*\{([^{}]*)\}", r" \1 ", text).replace("\\cdot", " ")
    text = re.sub(r"-(?!\d)", " ", text)
    reading = _UnitReading()
    if all(reading.take(match[0], match[1], match[2]) for match in _PIECE.finditer(text)):
        return reading.unit()
    return None


class _UnitReading:
    """Takes the words of a unit one by one."""

    def __init__(self) -> None:
        self.measures: dict[str, int] = {}
        self.factor = Fraction(1)
        self.nouns: set[str] = set()
        self.sign, self.power = 1, 1
        self.last: tuple[str, Fraction, int] | None = None
        self.named = False

    def take(self, piece: str, exponent: str | None, mark: str | None) -> bool:
        """Take a word; return whether it may be part of a unit."""
        word = piece.lower()
        if exponent or word in _POWERS_BEHIND:
            return self.raise_last(int(exponent) if exponent else _POWERS_BEHIND[word])
        if mark:
            return mark in ".,()"
        if piece == "/" or word == "per":
            self.sign = -1
        elif word in _POWERS_BEFORE:
            self.power = _POWERS_BEFORE[word]
        elif word in WORDS["rates"]:
            return all(self.take(part, None, None) for part in WORDS["rates"][word].replace("/", " / ").split())
        elif (found := _known(piece)) is not None:
            self.multiply(*found)
        elif word in WORDS["no_unit"] or _singular(word) in WORDS["no_unit"]:
            return False
        elif word not in _ARTICLES and self.sign > 0 and _singular(word) not in WORDS["empty_units"]:
            self.nouns.add(_singular(word))
        self.named = True
        return True

    def multiply(self, dimension: str, size: Fraction) -> None:
        self.count(dimension, size, self.sign * self.power)
        self.last, self.power = (dimension, size, self.sign), 1

    def raise_last(self, exponent: int) -> bool:
        if self.last is None:
            return self.named  # 45 units^2
        dimension, size, sign = self.last
        self.count(dimension, size, sign * (exponent - 1))
        self.last = None
        return True

    def count(self, dimension: str, size: Fraction, times: int) -> None:
        self.measures[dimension] = self.measures.get(dimension, 0) + times
        self.factor *= size**times

    def unit(self) -> Unit | None:
        if len(self.nouns) > _MAX_NOUNS:
            return None
        return Unit(frozenset(item for item in self.measures.items() if item[1]), self.factor, frozenset(self.nouns))


def is_measure(word: str) -> bool:
    r"""Return whether a word of two letters or more, without ``\text{}`` around it, is a known unit."""
    return word.lower() in WORDS["rates"] or (word not in _SINGLE and _known(word) is not None)


def go_together(first: Unit | None, second: Unit | None) -> bool:
    """Return whether two numbers with these units may be the same quantity; a missing unit goes with any."""
    if first is None or second is None:
        return True
    if {first, second} == {DEGREE, RADIAN}:
        return True
    if first.measures or second.measures:
        return first.measures == second.measures
    return not first.nouns or not second.nouns or bool(first.nouns & second.nouns)


def _known(word: str) -> tuple[str, Fraction] | None:
    # Mm is no millimetre.
    for spelling in (word,) if re.fullmatch("M[a-z]", word) else (word, word.lower(), _singular(word)):
        # Capital letters alone are no lengths and times: M is no metre.
        if spelling in _TABLE and (len(word) > 1 or word in _SINGLE):
            return _TABLE[spelling]
    return None


def _singular(word: str) -> str:
    word = word.lower()
    if word in WORDS["irregular"]:
        return str(WORDS["irregular"][word])
    if word.endswith("ies") and len(word) > 4:
        return word[:-3] + "y"
    return word[:-1] if word.endswith("s") and not word.endswith("ss") and len(word) > 2 else word


@dataclass(frozen=True)
class Leaf:
    """A number or formula, in LaTeX, with what stands behind it.

    Args:
        text: LaTeX of the formula.
        unit: Its unit.
        percent: Whether there is a per cent sign.
        base: Base of the number's digits, where one is written.
    """

    text: str
    unit: Unit | None = None
    percent: bool = False
    base: int | None = None


def exact(form: object) -> Fraction | None:
    """Return the value of a rational number; None of anything else."""
    return number_of(form.text) if isinstance(form, Leaf) and form.base is None and not form.percent else None


def equal_pairs(gold: Leaf, answer: Leaf) -> list[tuple[str, str]]:
    """Return pairs of formulas without units: two quantities are the same where one of these pairs is."""
    if not go_together(gold.unit, answer.unit):
        return []
    if gold.base is not None or answer.base is not None:
        return [("1", "1")] if _same_digits(gold, answer) else []
    plain = [(gold.text, answer.text)]
    if gold.percent != answer.percent:
        if any(leaf.unit is not None and leaf.unit.measures for leaf in (gold, answer)):
            return []
        # 25 % is 1/4, and the answer 25 to a question for a percentage; but 0.5, a probability, asks for none.
        texts = [f"({leaf.text})/100" if leaf.percent else leaf.text for leaf in (gold, answer)]
        hundredths = [(texts[0], texts[1])]
        part = exact(gold)
        return hundredths if answer.percent and part is not None and 0 < abs(part) < 1 else hundredths + plain
    if gold.unit is not None and answer.unit is not None and gold.unit.factor != answer.unit.factor:
        return [(f"({gold.text})({gold.unit.factor})", f"({answer.text})({answer.unit.factor})")]
    angles = [_in_radians(leaf) for leaf in (gold, answer)]
    if RADIAN in {gold.unit, answer.unit}:
        return [(angles[0], angles[1])]
    if (gold.unit == DEGREE) != (answer.unit == DEGREE) and r"\pi" in gold.text + answer.text:
        return [(angles[0], angles[1]), *plain]
    return plain


def _in_radians(leaf: Leaf) -> str:
    return rf"({leaf.text})\cdot\frac{{\pi}}{{180}}" if leaf.unit == DEGREE else leaf.text


def _same_digits(gold: Leaf, answer: Leaf) -> bool:
    if gold.base is None:
        return answer.base == 10 and gold.text == answer.text
    return answer.base in {None, gold.base} and gold.text.upper() == (answer.text.lstrip("0") or "0").upper()


_NUMERIC = re.compile(
    r"(?:\\(?:frac|sqrt|pi|cdot|times|div|binom|ln|log|exp|sin|cos|tan)(?![a-zA-Z])|[\d+\-*/^(){}.!\s])+"
)
_CURRENCY = re.compile(r"^(-?)\s*(?:(?:US|USD)?\s*\\\$|USD\b|US\b)\s*(-?)|^(-?)\s*(€|£|₹|¥|Rs\.?)\s*(-?)")
_CURRENCY_END = re.compile(r"\s*(\\\$|€|£|₹|¥)$")
_PERCENT = re.compile(
    r"\s*(?:\\?%|\\text\s*\{\s*(?:percent|per cent|pct|percentage|\\?%)\s*\}"
    r"|(?<=[\d}\s])(?:percent|per cent|pct|percentage))$"
)
_DEGREE = re.compile(r"\s*\^\s*(?:\{\s*\\circ\s*\}|\\circ)\s*(\\text\s*\{\s*[CF]\s*\}|[CF])?$")
_ANGLE_FUNCTION = re.compile(r"\\(?:sin|cos|tan|cot|sec|csc)(?![a-zA-Z])")
_EXPONENT = re.compile(r"^(-?\d+(?:\.\d+)?)\s*[eE]\s*([-+]?\d{1,3})$")
_MAX_EXPONENT = 400
_REPEATING = re.compile(r"(-?\d*)\.(\d*)\s*\\(?:overline|bar|dot)\s*\{\s*(\d+)\s*\}")
# 0.333… and 0.1666…: what comes three times goes on.
_GOING_ON = re.compile(r"^(-?\d*)\.(\d*?)(\d{1,6}?)\3{2,}\s*(?:\\ldots|\.\.\.)$")
_MIXED = re.compile(r"^(-?)\s*(\d+)\s+(\d+)\s*/\s*(\d+)$")
_BASE = re.compile(r"^([0-9A-Fa-f]+)\s*_\s*(?:\{\s*)?(?:\\text\s*\{\s*(\w+)\s*\}|(\d+))(?:\s*\})?$")
_ORDINAL = re.compile(r"^(\d+)\s*(?:\^\s*)?(?:\{?\s*\\text\s*\{\s*(?:st|nd|rd|th)\s*\}\s*\}?|(?:st|nd|rd|th))$")
_UNIT_WORD = r"(?:\\text\s*\{[^{}]*\}|(?<![\\A-Za-z])[A-Za-z]{2,}(?![A-Za-z]))(?:\s*\^\s*(?:\d|\{\s*-?\d\s*\}))?"
_TRAILING_UNIT = re.compile(
    rf"(?:\\cdot\s*)?{_UNIT_WORD}(?:\s*(?:/|\\cdot|-)?\s*(?:{_UNIT_WORD}|(?<=/)\s*[a-zA-Z]\b))*\s*$"
)
_SINGLE_UNIT = re.compile(
    r"^([-\d.,\s/]*\d(?:[eE][-+]?\d{1,3})?)\s+([a-zA-Z])((?:\^\s*\{?\s*[23]\s*\}?)?(?:\s*/\s*[a-zA-Z](?:\^\s*\{?\s*[23]\s*\}?)?)?)$"
)
_COMPOUND = re.compile(r"(\d+(?:\.\d+)?)\s*((?:\\text\s*\{[^{}]*\}|[A-Za-z]+))\s*(?:,|and|\\text\s*\{\s*and\s*\})?\s*")
NUMBERS: list[str] = WORDS["numbers"]
# 3xyz is a product, and so is 3 xyz; but 3 men are none.
_TIGHT = re.compile(r"[A-Za-z]{3}\s*")
_PRODUCT = re.compile(r"(?:[w-z]{3,4}|[a-d]{3,4}|[p-r]{3})\s*")
_BARE_WORD = re.compile(r"(?<![\\A-Za-z])[A-Za-z]{3,}(?![A-Za-z])|(?<![\\A-Za-z{])[A-Za-z]{2}(?![A-Za-z}])")


def read_quantity(text: str, *, loose_units: bool = False) -> Leaf | None:
    """Return a formula with what stands behind it; None where there are words in it."""
    text = text.strip()
    if match := _BASE.match(text):
        word = (match[2] or "").lower()
        base = NUMBERS.index(word) if word in NUMBERS else int(match[3] or 0)
        if 2 <= base <= 36 and (match[1].isdigit() or base > 10):
            return Leaf(match[1].lstrip("0") or "0", base=base)
    text = _REPEATING.sub(_fraction_of, text)
    if match := _MIXED.match(text):
        text = f"{match[1]}({match[2]}+{match[3]}/{match[4]})"
    if match := _ORDINAL.match(text_inside(text) if text.startswith(r"\text") else text):
        return Leaf(match[1])
    percent = _PERCENT.search(text)
    if percent and percent.start():
        return _formula(text[: percent.start()], None, percent=True)
    core, unit = _unit(text, loose_units)
    return _formula(core, unit)


def _formula(text: str, unit: Unit | None, percent: bool = False) -> Leaf | None:
    text = text.strip()
    if (match := _EXPONENT.match(text)) and abs(int(match[2])) <= _MAX_EXPONENT:
        text = rf"{match[1]} \cdot 10^{{{match[2]}}}"
    return None if has_words(text) else Leaf(text, unit, percent)


def _unit(text: str, loose_units: bool) -> tuple[str, Unit | None]:
    if match := _CURRENCY.match(text):
        sign = "-" if "-" in match[0] else ""
        unit = DOLLAR if match[4] is None else Unit(frozenset({(WORDS["currencies"].get(match[4], "rupee"), 1)}))
        core, more = _unit(text[match.end() :], loose_units)
        return sign + core, unit if more is None or not more.measures else more
    if (match := _CURRENCY_END.search(text)) and match.start():
        return text[: match.start()], DOLLAR if match[1] == r"\$" else Unit(
            frozenset({(WORDS["currencies"][match[1]], 1)})
        )
    if (match := _DEGREE.search(text)) and match.start() and not _ANGLE_FUNCTION.search(text):
        scale = {"C": "celsius", "F": "fahrenheit"}.get(re.sub(r"\\text|\W", "", match[1] or ""))
        return text[: match.start()], DEGREE if scale is None else Unit(frozenset({(scale, 1)}))
    if loose_units and (match := _SINGLE_UNIT.match(text)) and match[2] in _SINGLE:
        return match[1], read_unit(match[2] + match[3])
    return _trailing_unit(text)


def without_dots(text: str) -> str:
    """Return a decimal that goes on, as 0.333…, as the fraction that it is; any other text as it is."""
    return _GOING_ON.sub(_fraction_of, text)


def _fraction_of(match: re.Match[str]) -> str:
    """Return a repeating decimal as the fraction that it is."""
    sign, whole, fixed, block = match[1][:1].strip("0123456789"), match[1].lstrip("-") or "0", match[2], match[3]
    nines = (10 ** len(block) - 1) * 10 ** len(fixed)
    above = int(whole + fixed + block) - int(whole + fixed)
    return rf"{sign}\frac{{{above}}}{{{nines}}}"


def _trailing_unit(text: str) -> tuple[str, Unit | None]:
    start = max(0, len(text) - 120)
    for match in _TRAILING_UNIT.finditer(text, start):
        core, tail = text[: match.start()].strip(), match[0]
        tail_words = re.findall(r"[A-Za-z]+", re.sub(r"\\text", " ", tail))
        if not core or not re.search(r"[\d\w)}\]!]$", core) or re.search(r"[\\_^]$", core):
            continue
        multiple = WORDS["multiples"].get(tail_words[0].lower()) if tail_words else None
        if multiple is not None:
            rest = re.sub(r"(?i)" + tail_words[0], " ", tail, count=1)
            unit = read_unit(rest) if words_of(rest) else None
            return rf"({core})\cdot {multiple}", unit
        bare = _BARE_WORD.search(re.sub(r"\\text\s*\{[^{}]*\}", " ", tail))
        if bare and not (is_numeric(core) and all(is_measure(word) or len(word) > 2 for word in tail_words[:1])):
            continue
        if bare and not is_measure(tail) and (_PRODUCT if text[match.start() - 1] == " " else _TIGHT).fullmatch(tail):
            continue
        unit = read_unit(tail)
        if unit is not None:
            return core, unit
    return text, None


def is_numeric(text: str) -> bool:
    """Return whether a text is a formula without letters."""
    return _NUMERIC.fullmatch(text) is not None and re.search(r"\d|\\pi", text) is not None


def read_compound(text: str) -> Leaf | None:
    """Return the sum of a quantity in several units, as in 5 feet 3 inches; None of anything else."""
    found = _COMPOUND.findall(text) if len(text) <= 120 else []
    units = [read_unit(name) for _, name in found]
    if len(set(units)) < 2 or _COMPOUND.sub("", text).strip():
        return None
    measured = [unit for unit in units if unit is not None and unit.measures]
    if len(measured) < len(units) or len({unit.measures for unit in measured}) > 1:
        return None
    total = sum(Fraction(number) * unit.factor for (number, _), unit in zip(found, measured, strict=True))
    smallest = min(measured, key=lambda unit: unit.factor)
    return Leaf(str(total / smallest.factor), smallest)
