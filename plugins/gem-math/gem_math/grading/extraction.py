r"""Finds the final answer in a model's text: the last box, tag, formula or number."""

from __future__ import annotations

import re
from typing import NamedTuple

from gem_core.parsing import extract_last_boxed_answer, extract_last_tagged_answer
from gem_math.grading.text import close_of

_TAIL_CHARS = 20_000
# $…$, $$…$$, \(…\) and \[…\]; no mark looks further than the next one of its kind.
_FORMULA = re.compile(
    r"(\$\$[^$]+\$\$|\$[^$\n]+\$|\\\((?:(?!\\[()])[^\n])+\\\)|\\\[(?:(?!\\[\[\]]).)+\\\])|\\\$|\$\$", re.DOTALL
)
_DENIAL = re.compile(
    r"(?i)\b(?:not|never|wrong|incorrect|neither|nor|isn|cannot|no|or|either|maybe|perhaps|possibly)\b|n['\u2019]t\b"
)
_BOX = re.compile(r"\\boxed\s*\{")
_SEPARATION = re.compile(r"\\text\s*\{\s*(?:,?\s*(?:and|or)|,)\s*\}|\\q?quad|\b(?:and|or)\b|[,;\s$&]|\\[\[\](), ;]")
# A name before a box, as in x = \boxed{1} or x = \boxed{2}.
_NAMED = re.compile(r"(?<![^\s$(,;])(?:[A-Za-z]|\\[a-z]{2,})(?:_\{?\w\}?)?\s*=\s*$")
_JOINING = re.compile(r"\b(?:and|or)\b|[,;]")
_SENTENCE_END = re.compile(r"[.!?]\s|[.!?]$|\n\s*\n|\\\\\[")
_MAX_BETWEEN = 120
_PHRASE = re.compile(r"(?i)\b(?:final\s+)?answer\s*(?:is|:)\s*:?\s*")
# "… is 34." at the end of a sentence.
_LAST_NUMBER = re.compile(
    r"\b(?:is|are|equals|becomes|be)\s+(?:exactly\s+|equal\s+to\s+|therefore\s+|thus\s+)?(-?\$?\d[\d,]*(?:\.\d+)?\s*%?)\s*\.?$"
)


class Boxes(NamedTuple):
    """The contents of the last boxes of a text, where they belong together.

    Args:
        beside: Those with nothing but commas, 'and', names and white space between them, joined by commas, each with
            the name before it; None where there are no two.
        joined: Whether a comma or 'and' stands between all of them: then they are one answer together. Others may be
            the same answer twice.
        sentence: All of one sentence that enumerates them, with words between, joined by commas; None likewise.
    """

    beside: str | None
    joined: bool
    sentence: str | None


def extract_answer(text: str, *, strict: bool = False) -> str | None:
    r"""Return the final answer in a text: the last ``\boxed{}``, the last ``<answer>``, or all of it.

    Args:
        text: Model text.
        strict: Return None where there is neither a box nor a tag.
    """
    answer = extract_last_boxed_answer(text)
    if answer is None:
        answer = extract_last_tagged_answer(text)
    if answer is not None or strict:
        return answer
    text = text[-_TAIL_CHARS:].strip()
    *_, last = [None, *_PHRASE.finditer(text)]
    if last is not None:
        text = re.split(r"\n|\.\s", text[last.end() :], maxsplit=1)[0].strip()
    return _in_sentence(text) or text or None


def _in_sentence(text: str) -> str | None:
    """Return the last formula of a sentence, or the number that it ends with; None where it leaves a choice."""
    spans = formula_spans(text)
    words, position = "", 0
    for start, end in spans:
        words += text[position:start] + " "
        position = end
    words += text[position:]
    # In a sentence the last formula is the answer, unless the sentence denies it or leaves a choice.
    if not re.search(r"[A-Za-z]{3}", words.replace(" and ", " ")) or _DENIAL.search(words):
        return None
    if (number := _LAST_NUMBER.search(text[position:][-200:])) is not None:
        return number[1]
    return text[spans[-1][0] : spans[-1][1]] if spans else None


def formula_spans(text: str) -> list[tuple[int, int]]:
    r"""Return where formulas between ``$…$``, ``$$…$$``, ``\(…\)`` and ``\[…\]`` begin and end."""
    return [match.span() for match in _FORMULA.finditer(text) if match[1]]


def boxes_of(text: str) -> Boxes:
    """Return the contents of the last boxes of a text, where there are several that belong together."""
    text = text[-_TAIL_CHARS:]
    beside: list[str] = []
    sentence: list[str] = []
    position = 0
    joined = True
    for match in _BOX.finditer(text):
        if match.start() < position:
            continue
        end = close_of(text, match.end() - 1)
        if end < 0:
            break
        between = text[position : match.start()]
        name = _NAMED.search(between[-40:])
        if beside and _SEPARATION.sub("", between[: len(between) - len(name[0])] if name else between):
            beside, joined = [], True
        elif beside:
            joined = joined and _JOINING.search(between) is not None
        if sentence and not _enumerates(between):
            sentence = []
        content = text[match.end() : end]
        beside.append(name[0] + content if name else content)
        sentence.append(content)
        position = end + 1
    together = _together(beside)
    return Boxes(together, together is not None and joined, _together(sentence))


def _enumerates(between: str) -> bool:
    """Whether what stands between two boxes goes on in one sentence, and denies nothing."""
    if len(between) > _MAX_BETWEEN or _SENTENCE_END.search(between) or _DENIAL.search(between):
        return False
    return _JOINING.search(between) is not None


def _together(contents: list[str]) -> str | None:
    return ", ".join(contents) if 1 < len(contents) < 40 else None
