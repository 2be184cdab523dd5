r"""Reads answers with a whole number that may be any: 2\pi k, and x = 1 + 3n where n is an integer."""

from __future__ import annotations

import re
from typing import NamedTuple

from gem_math.grading_evaluation import EQUAL, Value, as_float, divide, is_zero
from gem_math.grading_formulas import UnsupportedError, read_formula
from gem_math.grading_numbers import value_of

_INTEGERS = r"(?:\\mathbb\s*\{\s*Z\s*\}|Z)"
_QUANTIFIER = r"(?:(?:all|any|some|every|each|an|the|arbitrary)\s+)*"
_DECLARED = re.compile(
    rf"(?:[,;(\s]|\\quad)*(?:(?:where|for|with|and)\s+)?{_QUANTIFIER}"
    rf"(?:([a-zA-Z])\s*(?:\\in\s*{_INTEGERS}|(?:is|being)\s+(?:an|any|some)\s+(?:arbitrary\s+)?integer|(?:an|any)\s+integer)"
    r"|(?<=[a-z] )integers?\s+([a-zA-Z]))\s*\)?$"
)
_UNION = re.compile(
    rf"(?:([a-zA-Z])\s*\\in\s*)?\\bigcup(?:\s*\\limits)?\s*_\s*\{{\s*([a-zA-Z])\s*\\in\s*{_INTEGERS}\s*\}}"
)
_USUAL = set("knmlj")
_LETTER = re.compile(r"\\[a-zA-Z]+|[a-zA-Z]")
_ANGLE = re.compile(r"\\pi|\\circ")
_HINT = re.compile(r"\\pi|\\circ|Z|integer")
_WORDS = re.compile(r"(?<!\\)\b[A-Za-z]{3}")
_MAX_DECLARATION = 120
_NAME = re.compile(r"^\s*[A-Za-z]\s*=")


class Parameter(NamedTuple):
    """Two answers with a whole number in them that may be any.

    Args:
        gold: The gold answer without what is said of the letter.
        answer: The answer likewise, with its letter renamed to that of the gold answer.
        letter: The letter.
        declared: Whether one of them says that it is a whole number.
    """

    gold: str
    answer: str
    letter: str
    declared: bool


def parameter_of(gold: str, answer: str) -> Parameter | None:
    """Return two answers, after ``clean``, with their whole number in one letter; None where they have none.

    A letter is one where that is said, or where it stands beside pi or degrees.
    """
    if not (_HINT.search(gold) or _HINT.search(answer)):
        return None
    (gold, ours), (answer, theirs) = _undeclared(gold), _undeclared(answer)
    declared = ours is not None or theirs is not None
    if not declared and not (_ANGLE.search(gold) and _ANGLE.search(answer)):
        return None
    letters = [set(_LETTER.findall(text)) for text in (gold, answer)]
    ours = ours or (theirs if theirs in letters[0] else _only(letters[0] & _USUAL))
    theirs = theirs or (ours if ours in letters[1] else _only(letters[1] & _USUAL))
    if ours is None or theirs is None or (ours != theirs and (ours in letters[1] or theirs in letters[0])):
        return None
    renamed = _LETTER.sub(lambda match: str(ours) if match[0] == theirs else match[0], answer)
    return Parameter(gold, renamed, ours, declared)


def _undeclared(text: str) -> tuple[str, str | None]:
    r"""Return an answer without 'where k is an integer' or \bigcup_{k \in Z}, and the letter that is said to be one."""
    flat = re.sub(r"\s+", " ", re.sub(r"\\text\s*\{([^{}]*)\}", r" \1 ", text)).strip()
    union = _UNION.match(flat)
    if union is not None and union[2] in _LETTER.findall(flat[union.end() :]):
        return flat[union.end() :], union[2]
    start = max(0, len(flat) - _MAX_DECLARATION)
    match = _DECLARED.search(flat, start)
    if match is None or not match.start() or _WORDS.search(flat[: match.start()]):
        return text, None
    body, letter = flat[: match.start()], match[1] or match[2]
    return (body, letter) if letter in _LETTER.findall(body) else (text, None)


def _only(letters: set[str]) -> str | None:
    return next(iter(letters)) if len(letters) == 1 else None


def same_progression(gold: str, answer: str, letter: str) -> bool:
    r"""Return whether two formulas a + pk have the same values for whole k, as \pi k and \pi(k + 1)."""
    names = {match[0].strip(" =") for match in map(_NAME.match, (gold, answer)) if match is not None}
    if len(names) > 1:
        return False
    ours, theirs = (_at_whole(_NAME.sub("", text), letter) for text in (gold, answer))
    if ours is None or theirs is None or is_zero(ours[1]):
        return False
    steps, shift = divide(theirs[1], ours[1]), divide(_minus(theirs[0], ours[0]), ours[1])
    return _is_whole(shift) and (is_zero(_minus(steps, 1)) or is_zero(_minus(steps, -1)))


def _at_whole(text: str, letter: str) -> tuple[Value, Value] | None:
    """Return the value at 0 and the step; None of a formula that does not grow by the same step."""
    values = [_value_at(text, letter, f"({number})") for number in range(4)]
    if None in values:
        return None
    try:
        steps = [_minus(values[index + 1], values[index]) for index in range(3)]
        return (
            (values[0], steps[0])
            if is_zero(_minus(steps[0], steps[1])) and is_zero(_minus(steps[1], steps[2]))
            else None
        )
    except UnsupportedError:
        return None


def _value_at(text: str, letter: str, number: str) -> Value | None:
    formula = read_formula(_LETTER.sub(lambda match: number if match[0] == letter else match[0], text))
    return None if formula is None else value_of(formula)


def _minus(one: Value, other: Value) -> Value:
    return as_float(one) - (other if isinstance(other, int) else as_float(other))


def _is_whole(value: Value) -> bool:
    number = as_float(value)
    return bool(abs(number.imag) < EQUAL and abs(number.real - round(number.real)) < EQUAL)
