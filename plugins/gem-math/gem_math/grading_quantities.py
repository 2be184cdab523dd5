r"""Reads one quantity: a formula with the unit, the currency, the per cent sign or the base of its digits."""

from __future__ import annotations

import re
from fractions import Fraction

from gem_math.grading_forms import Form, Leaf, Words
from gem_math.grading_formulas import read_formula
from gem_math.grading_numbers import exact_value
from gem_math.grading_text import words_of
from gem_math.grading_tokens import has_words, text_inside
from gem_math.grading_units import DEGREE, DOLLAR, Unit, is_measure, is_single_measure, read_unit

_MULTIPLES = {"hundred": 10**2, "thousand": 10**3, "million": 10**6, "billion": 10**9, "trillion": 10**12}
_CURRENCY = re.compile(r"^(-?)\s*(?:(?:US|USD)?\s*\\\$|USD\b|US\b)\s*(-?)|^(-?)\s*(€|£|₹|¥|Rs\.?)\s*(-?)")
_CURRENCY_END = re.compile(r"\s*(\\\$|€|£|₹|¥)$")
_CURRENCIES = {"€": "euro", "£": "sterling", "₹": "rupee", "¥": "yen"}
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
NUMBER_WORDS = dict(
    zip(
        [
            "zero",
            "one",
            "two",
            "three",
            "four",
            "five",
            "six",
            "seven",
            "eight",
            "nine",
            "ten",
            "eleven",
            "twelve",
            "thirteen",
            "fourteen",
            "fifteen",
            "sixteen",
            "seventeen",
            "eighteen",
            "nineteen",
            "twenty",
        ],
        range(21),
        strict=True,
    )
)
# 3xyz is a product, and so is 3 xyz; but 3 men are none.
_TIGHT = re.compile(r"[A-Za-z]{3}\s*")
_PRODUCT = re.compile(r"(?:[w-z]{3,4}|[a-d]{3,4}|[p-r]{3})\s*")
_BARE_WORD = re.compile(r"(?<![\\A-Za-z])[A-Za-z]{3,}(?![A-Za-z])")


def read_quantity(text: str, *, loose_units: bool = False) -> Form:
    """Return a formula with what stands behind it; words where there are words in it."""
    text = text.strip()
    if match := _BASE.match(text):
        base = NUMBER_WORDS.get((match[2] or "").lower(), int(match[3]) if match[3] else 0)
        if 2 <= base <= 36 and (match[1].isdigit() or base > 10):
            return Leaf(match[1].lstrip("0") or "0", base=base)
    if "overline" in text or "bar" in text or "dot" in text:
        text = _REPEATING.sub(_fraction_of, text)
    if r"\ldots" in text or "..." in text:
        text = _GOING_ON.sub(_fraction_of, text)
    if match := _MIXED.match(text):
        text = f"{match[1]}({match[2]}+{match[3]}/{match[4]})"
    if match := _ORDINAL.match(text_inside(text) if text.startswith(r"\text") else text):
        return Leaf(match[1])
    percent = _PERCENT.search(text)
    if percent and percent.start():
        return _formula(text[: percent.start()], None, percent=True)
    core, unit = _unit(text, loose_units)
    return _formula(core, unit)


def _formula(text: str, unit: Unit | None, percent: bool = False) -> Form:
    text = text.strip()
    if (match := _EXPONENT.match(text)) and abs(int(match[2])) <= _MAX_EXPONENT:
        text = rf"{match[1]} \cdot 10^{{{match[2]}}}"
    if has_words(text):
        return Words(words_of(text), text)
    return Leaf(text, unit, percent)


def _unit(text: str, loose_units: bool) -> tuple[str, Unit | None]:
    if match := _CURRENCY.match(text):
        sign = "-" if "-" in match[0] else ""
        unit = DOLLAR if match[4] is None else Unit(frozenset({(_CURRENCIES.get(match[4], "rupee"), 1)}))
        core, more = _unit(text[match.end() :], loose_units)
        return sign + core, unit if more is None or not more.measures else more
    if (match := _CURRENCY_END.search(text)) and match.start():
        return text[: match.start()], DOLLAR if match[1] == r"\$" else Unit(frozenset({(_CURRENCIES[match[1]], 1)}))
    if (match := _DEGREE.search(text)) and match.start() and not _ANGLE_FUNCTION.search(text):
        scale = {"C": "celsius", "F": "fahrenheit"}.get(re.sub(r"\\text|\W", "", match[1] or ""))
        return text[: match.start()], DEGREE if scale is None else Unit(frozenset({(scale, 1)}))
    if loose_units and (match := _SINGLE_UNIT.match(text)) and is_single_measure(match[2]):
        return match[1], read_unit(match[2] + match[3])
    return _trailing_unit(text)


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
        multiple = _MULTIPLES.get(tail_words[0].lower()) if tail_words else None
        if multiple is not None:
            rest = re.sub(r"(?i)" + tail_words[0], " ", tail, count=1)
            unit = read_unit(rest) if words_of(rest) else None
            return rf"({core})\cdot {multiple}", unit
        bare = _BARE_WORD.findall(re.sub(r"\\text\s*\{[^{}]*\}", " ", tail)) or re.search(
            r"(?<![\\A-Za-z{])[A-Za-z]{2}(?![A-Za-z}])", re.sub(r"\\text\s*\{[^{}]*\}", " ", tail)
        )
        numeric = exact_value(core) is not None or _is_value(core)
        if bare and not numeric:
            continue
        if bare and not all(is_measure(word) or len(word) > 2 for word in tail_words[:1]):
            continue
        if bare and not is_measure(tail) and (_PRODUCT if text[match.start() - 1] == " " else _TIGHT).fullmatch(tail):
            continue
        unit = read_unit(tail)
        if unit is not None:
            return core, unit
    return text, None


def _is_value(text: str) -> bool:
    """Return whether a text is a formula without letters."""
    formula = read_formula(text)
    return formula is not None and not formula.letters


def read_compound(text: str) -> Leaf | None:
    """Return the sum of a quantity in several units, as in 5 feet 3 inches; None of anything else."""
    if text.count("\\text") > 8 or len(text) > 120 or len(_COMPOUND.findall(text)) < 2:
        return None
    if _COMPOUND.sub("", text).strip():
        return None
    total, measures = Fraction(0), None
    smallest: Unit | None = None
    for number, name in _COMPOUND.findall(text):
        unit = read_unit(name)
        if unit is None or not unit.measures or (measures is not None and unit.measures != measures):
            return None
        measures = unit.measures
        total += Fraction(number) * unit.factor
        smallest = unit if smallest is None or unit.factor < smallest.factor else smallest
    if smallest is None or len({read_unit(name) for _, name in _COMPOUND.findall(text)}) < 2:
        return None
    return Leaf(str(total / smallest.factor), smallest)
