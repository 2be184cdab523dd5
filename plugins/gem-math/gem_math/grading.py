r"""``grade``: compares a model's final answer with the reference."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

from gem_core.errors import GradingError
from gem_core.parsing import extract_last_boxed_answer
from gem_math.grading_compare import Comparison
from gem_math.grading_extraction import boxes_of, extract_answer
from gem_math.grading_forms import Form, Leaf, Many, Opaque, Words
from gem_math.grading_leaves import exact_of
from gem_math.grading_parameters import parameter_of, same_progression
from gem_math.grading_pool import shared_pool
from gem_math.grading_reading import read
from gem_math.grading_text import clean

MAX_ANSWER_CHARS = 4000
_AMBIGUOUS_THOUSANDS = re.compile(r"(?<![\d,])[1-9]\d{0,2}(?:,[1-9]\d\d)+(?![\d,])")
_PLAIN_NUMBER = re.compile(
    r"\s*(?:(-?(?:[1-9]\d{0,2}(?:,\d{3})+|\d{1,40})(?:\.\d{1,40})?)"
    r"|(-?\d{1,40})\s*/\s*(\d{1,40})|\\[dt]?frac\{(-?\d{1,40})\}\{(\d{1,40})\})\s*",
    re.ASCII,
)
_MANY_PLACES = re.compile(r"\.\d{6}")
_ALIKE, _EQUALS = "it is written like the reference", "it equals the reference"
_DIFFERS = "it is not the reference"
_DECIMAL_COMMA = re.compile(r"^\s*-?\d+,\d+\s*$")
_DECIMAL_POINT = re.compile(r"^\s*-?\d+\.\d\d+\s*$")


@dataclass(frozen=True)
class Grade:
    """The verdict on an answer.

    Args:
        reward: 1.0 or 0.0; with ``partial_credit`` the fraction of the parts that are right.
        correct: Whether all of it is right.
        answer: What was read out of the text; None when there was nothing to read.
        reason: Why, in one sentence.
    """

    reward: float
    correct: bool
    answer: str | None
    reason: str


class _TimeIsUpError(Exception):
    """The comparison takes too long, by no fault of the gold answer."""


def grade(
    answer: str, gold: Any, *, timeout_s: float = 1.0, partial_credit: bool = False, strict: bool = False
) -> Grade:
    r"""Compare a model's final answer with the reference.

    The answer is the content of the last ``\boxed{}``; without one, of the last ``<answer>`` tag; without that, what
    follows "the answer is", or the whole text.

    Args:
        answer: Model text.
        gold: The reference: LaTeX or plain text, with or without dollar signs, or a number; or a list of these, each of
            which is right.
        timeout_s: Limit of the computing for each reference, in seconds. It holds in any thread and process. What waits
            for a free process does not count.
        partial_credit: Give the fraction of the parts that are right where the reference has several, and none to
            answers with more parts than it.
        strict: Read only a box or a tag.

    Returns:
        Grade with ``reward``, ``correct``, the extracted ``answer`` and the ``reason``.

    Raises:
        GradingError: The gold answer is empty or no text, or the grader itself failed: the verdict is unknown. One that
            cannot be read, or takes too long, is compared as text.

    Source: the boxed-answer convention of MATH, arXiv:2103.03874; math-verify 0.9.0 for what evaluation does not tell.
    """
    golds = gold_texts(gold)
    boxes = boxes_of(answer)
    extracted = boxes.beside if boxes.joined else extract_answer(answer, strict=strict)
    others = [other for other in (boxes.beside, boxes.sentence) if other not in {None, extracted}]
    best = _refused(extracted, strict)
    if best is None:
        best = Grade(0.0, False, extracted, _DIFFERS)
        for one in golds:
            for text in dict.fromkeys([extracted, *others]):
                best = max(best, _graded(str(text), one, timeout_s, partial_credit), key=_rank)
                if best.correct:
                    return best
    whole = None if strict else answer.strip()
    unread = (one for one in golds if not is_readable(one) and _written_alike(answer, extracted, one))
    alike = whole if whole in golds else next(unread, None)
    return best if alike is None else Grade(1.0, True, alike, _ALIKE)


@lru_cache(maxsize=1024)
def is_readable(gold: str) -> bool:
    """Return whether a gold answer can be read; one with brackets that do not match, or too long, is text alone."""
    if _plain_number(gold) is not None:
        return True
    form = read(clean(gold)) if len(gold) <= MAX_ANSWER_CHARS else None
    return form is not None and not (isinstance(form, Opaque) and form.unreadable)


def _written_alike(response: str, extracted: str | None, gold: str) -> bool:
    """Whether an answer is a text but for white space and braces, which close a box too early or never."""
    wanted = _bare_text(gold)
    texts = [extracted or "", response.rpartition(r"\boxed")[2] if r"\boxed" in response else ""]
    return wanted != "" and any(len(text) < len(gold) + 200 and _bare_text(text) == wanted for text in texts)


def _bare_text(text: str) -> str:
    return re.sub(r"[\s{}$]+", "", clean(text)).rstrip(".\\").casefold()


def _refused(extracted: str | None, strict: bool) -> Grade | None:
    """Return the verdict on what cannot be compared: nothing, or too much."""
    if extracted is None:
        return Grade(0.0, False, None, "there is no \\boxed{} and no <answer>" if strict else "there is no answer")
    if not extracted.strip():
        return Grade(0.0, False, "", "the answer is empty")
    if len(extracted) > MAX_ANSWER_CHARS:
        return Grade(0.0, False, extracted[:80] + "…", f"the answer has more than {MAX_ANSWER_CHARS} characters")
    return None


def _graded(answer: str, gold: str, timeout_s: float, partial_credit: bool) -> Grade:
    try:
        return _grade_one(answer, gold, timeout_s, partial_credit)
    except GradingError:
        raise
    except Exception as error:  # a fault of the grader, whatever it is, is no verdict
        name = type(error).__name__
        raise GradingError(
            f"the grader failed with {name}: {error}. Please report the gold answer {gold!r:.200} "
            f"with the answer {answer!r:.200}"
        ) from error


def _rank(verdict: Grade) -> tuple[float, bool]:
    return verdict.reward, verdict.reason != _DIFFERS


def gold_texts(gold: Any) -> list[str]:
    """Return the texts of a row's gold answer, which may be one value or several."""
    if isinstance(gold, str | int | float) and not isinstance(gold, bool):
        golds: list[Any] = [gold]
    elif isinstance(gold, Sequence) and not isinstance(gold, bytes):
        golds = list(gold)
    elif hasattr(gold, "tolist"):  # NumPy's numbers and arrays
        return gold_texts(gold.tolist())
    else:
        golds = [gold]
    texts = [str(one).strip() for one in golds if one is not None and not isinstance(one, list | dict)]
    if not texts or not all(texts) or len(texts) != len(golds):
        raise GradingError(
            f"the gold answer must be a text, a number or a list of these, and not empty: it is {gold!r}"
        )
    return [_boxed(text) or text for text in texts]


def _boxed(gold: str) -> str | None:
    boxes = boxes_of(gold)
    return boxes.sentence or boxes.beside or extract_last_boxed_answer(gold)


class _Asking:
    """Asks math-verify, within what is left of the time.

    Only computing counts: the processor time of this thread, and the time that the process takes; not the wait of many
    threads for few processes.
    """

    def __init__(self, timeout_s: float) -> None:
        self.timeout_s = timeout_s
        self.started = time.thread_time()
        self.asked_s = 0.0
        self.note = ""

    def left_s(self) -> float:
        return self.timeout_s - self.asked_s - (time.thread_time() - self.started)

    def check_time(self) -> None:
        if self.left_s() <= 0:
            raise _TimeIsUpError

    def ask(self, gold_text: str, answer_text: str) -> bool:
        self.check_time()
        verdict = shared_pool().compare(gold_text, answer_text, self.left_s())
        self.asked_s += verdict.took_s
        if verdict.reason:
            reason = f"it takes more than {self.timeout_s:g} s" if verdict.late else verdict.reason.partition("\n")[0]
            self.note = self.note or f"it is not written like the reference, and cannot be compared otherwise: {reason}"
        return verdict.same


def _grade_one(answer: str, gold: str, timeout_s: float, partial_credit: bool) -> Grade:
    numbers = _plain_number(gold), _plain_number(answer)
    if None not in numbers and numbers[0] == numbers[1]:
        return Grade(1.0, True, answer, _EQUALS)
    # Many places may stand for a number that has no end as a decimal.
    if None not in numbers and not _MANY_PLACES.search(f"{gold} {answer}"):
        return Grade(0.0, False, answer, _DIFFERS)
    if answer.strip() == gold.strip():
        return Grade(1.0, True, answer, _ALIKE)
    asking = _Asking(timeout_s)
    comparison = Comparison(asking.ask, asking.check_time)
    cleaned = clean(gold), clean(answer)
    if _spelling(cleaned[0]) == _spelling(cleaned[1]):
        return Grade(1.0, True, answer, _ALIKE)
    golds, answers = readings(*cleaned)
    try:
        if any(comparison.same(one, other) for one in golds for other in answers):
            return Grade(1.0, True, answer, _EQUALS)
        if _same_for_any_whole(comparison, *cleaned):
            return Grade(1.0, True, answer, _EQUALS)
        reward = _part_right(comparison, golds[0], answers[0]) if partial_credit else 0.0
    except _TimeIsUpError:
        return Grade(0.0, False, answer, f"the answer cannot be compared: it takes more than {timeout_s:g} s")
    return Grade(reward, False, answer, asking.note or _DIFFERS)


def _same_for_any_whole(comparison: Comparison, gold: str, answer: str) -> bool:
    """Whether both are the same up to the name of a whole number that may be any."""
    parameter = parameter_of(gold, answer)
    if parameter is None:
        return False
    if parameter.declared and comparison.same(read(parameter.gold), read(parameter.answer)):
        return True
    return same_progression(parameter.gold, parameter.answer, parameter.letter)


def _plain_number(text: str) -> Fraction | None:
    """Return the value of a text that is nothing but a number or a fraction of two; None of all else."""
    match = _PLAIN_NUMBER.fullmatch(text)
    if match is None:
        return None
    number, above, below, over, under = match.groups()
    if number:
        return Fraction(number.replace(",", ""))
    above, below = above or over, below or under
    return Fraction(int(above), int(below)) if int(below) else None


def _spelling(text: str) -> str:
    # 1 8 is not 18.
    return re.sub(r"(?<!\d)\s+|\s+(?!\d)", "", text)


def readings(gold: str, answer: str) -> tuple[list[Form], list[Form]]:
    """Return the ways to read both, after ``clean``; 1,234 is a number first, and two where the other side has two."""
    gold_form = read(gold)
    loose = isinstance(gold_form, Leaf) and gold_form.formula is not None and not gold_form.formula.letters
    golds, answers = [gold_form], [read(answer, loose_units=loose)]
    if _AMBIGUOUS_THOUSANDS.search(gold) and not isinstance(answers[0], Leaf):
        golds.append(read(gold, join_thousands=False))
    elif _AMBIGUOUS_THOUSANDS.search(answer) and not isinstance(gold_form, Leaf):
        answers.append(read(answer, join_thousands=False))
    if _is_decimal_comma(answer, answers[0]) and loose and _is_no_list(gold, gold_form):
        answers.append(read(answer.replace(",", ".")))
    elif _is_decimal_comma(gold, gold_form) and (_DECIMAL_POINT.match(answer) or gold.lstrip("-").startswith("0,")):
        # 1,25 may be a decimal, and 0,5 is one; 1,5 is 1 and 5.
        golds.append(read(gold.replace(",", ".")))
    return golds, answers


def _is_decimal_comma(text: str, form: Form) -> bool:
    """Whether a text that was read as two numbers may be one with a decimal comma."""
    return isinstance(form, Many) and _DECIMAL_COMMA.match(text) is not None


def _is_no_list(gold: str, form: Form) -> bool:
    """Whether a gold answer is one number that is not whole, which 1,5 may stand for."""
    value = exact_of(form)
    return "," not in gold and value is not None and value.denominator > 1


def _part_right(comparison: Comparison, gold: Form, answer: Form) -> float:
    """Return the fraction of the parts of a list or set that the answer has; 0 for an answer with more parts."""
    if not isinstance(gold, Many) or not gold.items or isinstance(answer, Words):
        return 0.0
    left = list(answer.items if isinstance(answer, Many) else (answer,))
    if len(left) > len(gold.items):
        return 0.0
    right = 0
    for item in gold.items:
        found = next((index for index, one in enumerate(left) if comparison.same(item, one)), None)
        if found is not None:
            right += 1
            del left[found]
    return right / len(gold.items)
