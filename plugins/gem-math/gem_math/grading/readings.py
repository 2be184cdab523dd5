r"""Compares two texts in all the ways in which they may be read: decimal commas, and letters for any whole number."""

from __future__ import annotations

import re
from types import ModuleType

from gem_math.grading.compare import Comparison
from gem_math.grading.forms import Form, Parts
from gem_math.grading.quantities import Leaf, exact, is_numeric
from gem_math.grading.structure import read

_AMBIGUOUS_THOUSANDS = re.compile(r"(?<![\d,])[1-9]\d{0,2}(?:,[1-9]\d\d)+(?![\d,])")
_DECIMAL_COMMA = re.compile(r"^\s*-?\d+,\d+\s*$")
_DECIMAL_POINT = re.compile(r"^\s*-?\d+\.\d\d+\s*$")
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
_WORDS = re.compile(r"(?<!\\)\b[A-Za-z]{3}")
_MAX_DECLARATION = 120
_NAME = re.compile(r"^\s*[A-Za-z]\s*=")


def compare_texts(gold: str, answer: str, partial_credit: bool, parser: ModuleType | None = None) -> tuple[float, str]:
    """Compare two texts, after ``clean``.

    Args:
        gold: The reference.
        answer: The answer.
        partial_credit: Whether some of several parts count.
        parser: The module ``gem_math.grading.formulas``, in a process that may be ended.

    Returns:
        1 where they are the same, or the fraction of the parts that are right; and why a pair of formulas could not be
        compared, if one was.

    Raises:
        NeedsParserError: There are formulas, and no parser.
    """
    comparison = Comparison(parser)
    golds, answers = readings(gold, answer)
    if any(comparison.same(one, other) for one in golds for other in answers):
        return 1.0, ""
    if _same_for_any_whole(comparison, gold, answer):
        return 1.0, ""
    return (comparison.part_right(golds[0], answers[0]) if partial_credit else 0.0), comparison.note


def readings(gold: str, answer: str) -> tuple[list[Form], list[Form]]:
    """Return the ways to read both, after ``clean``; 1,234 is a number first, and two where the other side has two."""
    gold_form = read(gold)
    loose = isinstance(gold_form, Leaf) and is_numeric(gold_form.text)
    golds, answers = [gold_form], [read(answer, loose_units=loose)]
    if _AMBIGUOUS_THOUSANDS.search(gold) and not isinstance(answers[0], Leaf):
        golds.append(read(gold, join_thousands=False))
    elif _AMBIGUOUS_THOUSANDS.search(answer) and not isinstance(gold_form, Leaf):
        answers.append(read(answer, join_thousands=False))
    # 1,5 may stand for a number that is not whole.
    value = exact(gold_form)
    if _is_decimal_comma(answer, answers[0]) and "," not in gold and value is not None and value.denominator > 1:
        answers.append(read(answer.replace(",", ".")))
    elif _is_decimal_comma(gold, gold_form) and (_DECIMAL_POINT.match(answer) or gold.lstrip("-").startswith("0,")):
        # 1,25 may be a decimal, and 0,5 is one; 1,5 is 1 and 5.
        golds.append(read(gold.replace(",", ".")))
    return golds, answers


def _is_decimal_comma(text: str, form: Form) -> bool:
    """Whether a text that was read as two numbers may be one with a decimal comma."""
    return isinstance(form, Parts) and form.kind == "list" and _DECIMAL_COMMA.match(text) is not None


def _same_for_any_whole(comparison: Comparison, gold: str, answer: str) -> bool:
    r"""Whether both are the same up to the name of a whole number that may be any: 2\pi k, and 1 + 3n, n an integer.

    A letter is one where that is said, or where it stands beside pi or degrees.
    """
    (gold, ours), (answer, theirs) = _undeclared(gold), _undeclared(answer)
    declared = ours is not None or theirs is not None
    if not declared and not (_ANGLE.search(gold) and _ANGLE.search(answer)):
        return False
    letters = [set(_LETTER.findall(text)) for text in (gold, answer)]
    ours = ours or (theirs if theirs in letters[0] else _only(letters[0] & _USUAL))
    theirs = theirs or (ours if ours in letters[1] else _only(letters[1] & _USUAL))
    if ours is None or theirs is None or (ours != theirs and (ours in letters[1] or theirs in letters[0])):
        return False
    answer = _LETTER.sub(lambda match: str(ours) if match[0] == theirs else match[0], answer)
    if declared and comparison.same(read(gold), read(answer)):
        return True
    names = {match[0].strip(" =") for match in map(_NAME.match, (gold, answer)) if match is not None}
    values = [_NAME.sub("", text) for text in (gold, answer)]
    return len(names) < 2 and comparison.ask(comparison.parser.same_progression, *values, ours)


def _undeclared(text: str) -> tuple[str, str | None]:
    r"""Return an answer without 'where k is an integer' or \bigcup_{k \in Z}, and the letter that is said to be one."""
    flat = re.sub(r"\s+", " ", re.sub(r"\\text\s*\{([^{}]*)\}", r" \1 ", text)).strip()
    union = _UNION.match(flat)
    if union is not None and union[2] in _LETTER.findall(flat[union.end() :]):
        return flat[union.end() :], union[2]
    match = _DECLARED.search(flat, max(0, len(flat) - _MAX_DECLARATION))
    if match is None or not match.start() or _WORDS.search(flat[: match.start()]):
        return text, None
    body, letter = flat[: match.start()], match[1] or match[2]
    return (body, letter) if letter in _LETTER.findall(body) else (text, None)


def _only(letters: set[str]) -> str | None:
    return next(iter(letters)) if len(letters) == 1 else None
