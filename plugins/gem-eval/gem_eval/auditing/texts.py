"""Comparing texts as an audit does: without case, spacing and marks."""

from __future__ import annotations

import re
import unicodedata

_SPACES = re.compile(r"\s+")
_NOT_WORD = re.compile(r"[^\w]+")


def normal(text: str) -> str:
    """Return a text with small letters and single spaces."""
    return _SPACES.sub(" ", unicodedata.normalize("NFKC", text).casefold()).strip()


def words(text: str) -> list[str]:
    """Return the words of a text, without marks and case."""
    return _NOT_WORD.sub(" ", normal(text)).split()


def holds(text: str, part: str) -> bool:
    """Tell whether a normal text holds another one that is no piece of a longer word or number."""
    if not part:
        return False
    start = text.find(part)
    while start >= 0:
        end = start + len(part)
        before, behind = text[start - 1 : start], text[end : end + 1]
        apart = not (
            part[0].isalnum() and (before.isalnum() or (before in ".," and text[start - 2 : start - 1].isdigit()))
        )
        ends = not (part[-1].isalnum() and (behind.isalnum() or (behind == "." and text[end + 1 : end + 2].isdigit())))
        if apart and ends:
            return True
        start = text.find(part, start + 1)
    return False
