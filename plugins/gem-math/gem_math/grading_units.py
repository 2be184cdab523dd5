"""Units behind a number: which there are, what they measure, and whether two go together."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import NamedTuple


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
for _dimension, _names in {
    "length": "1 m meter metre|1/100 cm centimeter centimetre|1/1000 mm millimeter millimetre"
    "|1000 km kilometer kilometre|127/5000 inch in|381/1250 foot feet ft|1143/1250 yard yd|201168/125 mile mi"
    "|1/1000000 micrometer micrometre micron microm|1/10000000000 angstrom",
    "time": "1 s sec second|60 min minute|3600 h hr hour|86400 day|604800 week",
    "months": "1 month|12 year yr",
    "mass": "1 g gram gm|1000 kg kilogram|1/1000 mg milligram|45359237/100000 lb pound lbs|1000000 tonne",
    "volume": "1 l L liter litre|1/1000 ml mL milliliter millilitre|3785411784/1000000000 gallon gal",
    "dollar": "1 dollar usd buck|1/100 cent",
    "euro": "1 euro eur",
    "sterling": "1 gbp",
    "angle": "1 degree deg",
    "radian": "1 rad radian",
    "celsius": "1 celsius",
    "fahrenheit": "1 fahrenheit",
    "force": "1 N newton",
    "energy": "1 J joule",
    "power": "1 W watt",
    "resistance": "1 ohm|1000 kohm kiloohm|1000000 Mohm megaohm",
    "frequency": "1 Hz hertz",
}.items():
    for _line in _names.split("|"):
        _factor, *_spellings = _line.split()
        _TABLE.update(dict.fromkeys(_spellings, (_dimension, Fraction(_factor))))
_RATES = {"mph": "mile/hour", "kmph": "km/hour", "kph": "km/hour", "kmh": "km/hour", "fps": "ft/second"}
_IRREGULAR = {"inches": "inch", "feet": "foot", "men": "man", "women": "woman", "children": "child", "people": "person",
              "boxes": "box", "dice": "die", "mice": "mouse", "halves": "half", "geese": "goose"}  # fmt: skip
_NOTHING = {"unit", "st", "nd", "rd", "th", "total", "in"}
# A sentence is no unit.
_NO_UNIT = {
    "is", "are", "was", "not", "no", "nor", "or", "and", "but", "isn't", "wrong", "maybe", "perhaps", "never", "then",
    "plus", "minus", "times", "than", "about", "if", "else", "either", "any", "all", "except", "unless", "where",
    "when", "because", "since", "between", "to", "from", "through", "incorrect", "false", "hundred", "thousand",
    "million", "billion", "trillion", "half", "third", "quarter", "possibly", "answer", "correct", "true",
    "choose", "mod", "modulo", "divided", "over", "factorial", "percent", "infinity", "double", "twice",
    "ten", "hundredth", "thousandth", "millionth", "tenth", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth",
    "below", "above", "under", "excluded", "excluding", "exclusive", "short", "before", "beyond", "versus", "vs",
}  # fmt: skip
_SINGLE = {"m", "s", "h", "g", "l", "L", "N", "J", "W"}
_PIECE = re.compile(r"[^\W\d_]+(?:'[a-z]+)?|\^\s*\{?\s*(-?\d)\s*\}?|/|(\S)")
_MAX_NOUNS = 4
_POWERS_BEFORE = {"square": 2, "sq": 2, "cubic": 3, "cu": 3}
_POWERS_BEHIND = {"squared": 2, "cubed": 3}
_ARTICLES = {"each", "a", "an"}


def read_unit(text: str) -> Unit | None:
    """Return the unit that a text names, as in ``square cm`` or ``km/h``; None where it is more than a unit."""
    text = re.sub(r"\\text\s*\{([^{}]*)\}", r" \1 ", text).replace("\\cdot", " ").replace("-", " ")
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
        elif word in _RATES:
            return all(self.take(part, None, None) for part in _RATES[word].replace("/", " / ").split())
        elif (found := _known(piece)) is not None:
            self.multiply(*found)
        elif word in _NO_UNIT or _singular(word) in _NO_UNIT:
            return False
        elif word not in _ARTICLES and self.sign > 0 and _singular(word) not in _NOTHING:
            self.nouns.add(_singular(word))
        self.named = True
        return True

    def multiply(self, dimension: str, size: Fraction) -> None:
        times = self.sign * self.power
        self.measures[dimension] = self.measures.get(dimension, 0) + times
        self.factor *= size**times
        self.last, self.power = (dimension, size, self.sign), 1

    def raise_last(self, exponent: int) -> bool:
        if self.last is None:
            return self.named  # 45 units^2
        dimension, size, sign = self.last
        self.measures[dimension] += sign * (exponent - 1)
        self.factor *= size ** (sign * (exponent - 1))
        self.last = None
        return True

    def unit(self) -> Unit | None:
        if len(self.nouns) > _MAX_NOUNS:
            return None
        return Unit(frozenset(item for item in self.measures.items() if item[1]), self.factor, frozenset(self.nouns))


def is_measure(word: str) -> bool:
    r"""Return whether a word of two letters or more, without ``\text{}`` around it, is a known unit."""
    return word.lower() in _RATES or (word not in _SINGLE and _known(word) is not None)


def is_single_measure(letter: str) -> bool:
    """Return whether a letter may be a unit where it cannot be a variable."""
    return letter in _SINGLE


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
    if word in _IRREGULAR:
        return _IRREGULAR[word]
    if word.endswith("ies") and len(word) > 4:
        return word[:-3] + "y"
    return word[:-1] if word.endswith("s") and not word.endswith("ss") and len(word) > 2 else word
