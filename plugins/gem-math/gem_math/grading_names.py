r"""Compares the names that stand on one side of an equation."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from gem_math.grading_reading import read

if TYPE_CHECKING:
    from gem_math.grading_forms import Assignment, Form

_WORD = re.compile(r"[A-Za-z][a-z]{3,}")
_ANY_NAME = {"answer", "ans", "result", "value", "total", "solution", "final", "output"}
_FUNCTION_NAME = re.compile(r"^([A-Za-z])\(([A-Za-z])\)$")


def same_name(first: str, second: str) -> bool:
    """Return whether two names may name one thing."""
    if first == second:
        return True
    # Words name nothing that a formula needs: "Area = 5" and "A = 5".
    words = [_word_of(name) for name in (first, second)]
    if None not in words:
        first, second = sorted(map(str, words), key=len)
        return bool({first, second} & _ANY_NAME) or second.startswith(first)
    return words != [None, None]


def _word_of(name: str) -> str | None:
    """Return the first word of a name; None of a name of letters, such as a_1, AB and f(x, y)."""
    match = _WORD.match(re.sub(r"\\(?:angle|triangle|measuredangle)", "", name))
    return match[0].lower() if match else None


def renamed(name: str, answer: Assignment) -> Form | None:
    """Return the value of g(x) = … in the variable of the name g(n); None where the names differ otherwise."""
    ours, theirs = _FUNCTION_NAME.match(name), _FUNCTION_NAME.match(answer.name)
    if ours is None or theirs is None or ours[1] != theirs[1] or not answer.right:
        return None
    tokens = re.findall(r"\\[a-zA-Z]+|.", answer.right, re.DOTALL)
    if ours[2] in tokens:
        return None
    return read("".join(ours[2] if token == theirs[2] else token for token in tokens))
