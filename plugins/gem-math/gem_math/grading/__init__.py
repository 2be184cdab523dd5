r"""``grade``: compares a model's final answer with the reference."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from gem_core.errors import GradingError
from gem_core.parsing import extract_last_boxed_answer, without_thinking
from gem_math.grading.compare import NeedsParserError
from gem_math.grading.extraction import boxes_of, extract_answer
from gem_math.grading.readings import compare_texts
from gem_math.grading.text import UnreadableError, clean, walk
from gem_math.processes import EndedError, Pool

MAX_ANSWER_CHARS = 4000
_MAX_CHARS_HERE = 300
"""Longer texts are compared by a process with a limit of time: some of what reads them takes quadratic time."""
_ALIKE, _EQUALS = "it is written like the reference", "it equals the reference"
_DIFFERS = "it is not the reference"


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_pool = Pool("gem_math.grading.worker", "the grader", GradingError, _cores())


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


def grade(
    answer: str, gold: Any, *, timeout_s: float = 1.0, partial_credit: bool = False, strict: bool = False
) -> Grade:
    r"""Compare a model's final answer with the reference.

    The answer is the content of the last ``\boxed{}``; without one, of the last ``<answer>`` tag; without that, what
    follows "the answer is", or the whole text. Thinking is left out: what stands in it alone is no answer.

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

    Source: the boxed-answer convention of MATH, arXiv:2103.03874; math-verify 0.9.0 for formulas.
    """
    golds = gold_texts(gold)
    answer = without_thinking(answer)
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
    try:
        return gold.isdigit() or (len(gold) <= MAX_ANSWER_CHARS and walk(clean(gold)) is not None)
    except UnreadableError:
        return False


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


def _grade_one(answer: str, gold: str, timeout_s: float, partial_credit: bool) -> Grade:
    gold, answer_text = clean(gold), clean(answer)
    if _spelling(gold) == _spelling(answer_text):
        return Grade(1.0, True, answer, _ALIKE)
    reward = _compared_here(gold, answer_text, partial_credit)
    if reward is not None:
        verdict: dict[str, Any] = {"reward": reward, "note": ""}
    else:
        request = {"gold": gold, "answer": answer_text, "partial_credit": partial_credit}
        try:
            verdict = _pool.ask(request, timeout_s)
        except EndedError as error:
            verdict = {"reward": 0.0, "note": str(error)}
    if "raised" in verdict:
        raise RuntimeError(verdict["raised"])
    if verdict["reward"] == 1.0:
        return Grade(1.0, True, answer, _EQUALS)
    note = f"it is not written like the reference, and cannot be compared otherwise: {verdict['note']}"
    return Grade(verdict["reward"], False, answer, note if verdict["note"] else _DIFFERS)


def _compared_here(gold: str, answer: str, partial_credit: bool) -> float | None:
    """Compare what is short and has no formulas, as numbers, words and lists of them; None of anything else."""
    if max(len(gold), len(answer)) > _MAX_CHARS_HERE:
        return None
    try:
        return compare_texts(gold, answer, partial_credit)[0]
    except (NeedsParserError, ValueError):  # Python writes no number of more than 4300 digits
        return None


def _spelling(text: str) -> str:
    # 1 8 is not 18.
    return re.sub(r"(?<!\d)\s+|\s+(?!\d)", "", text)
