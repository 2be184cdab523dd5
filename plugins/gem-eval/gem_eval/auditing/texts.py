"""Comparing texts as an audit does: without case, spacing and marks."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from functools import lru_cache


def normal(text: str) -> str:
    """Return a text with small letters and single spaces."""
    return " ".join(unicodedata.normalize("NFKC", text).casefold().split())


def holds(text: str, part: str) -> bool:
    """Tell whether a normal text holds another one that is no piece of a longer word or number."""
    return next(places(text, part), None) is not None


def places(text: str, part: str) -> Iterator[int]:
    """Yield where a normal text holds another one that is no piece of a longer word or number."""
    return (found.start() for found in _whole(part).finditer(text)) if part else iter(())


@lru_cache(maxsize=4096)
def _whole(part: str) -> re.Pattern[str]:
    before = r"(?<![^\W_])(?<!\d[.,])" if part[0].isalnum() else ""
    behind = r"(?![^\W_])(?!\.\d)" if part[-1].isalnum() else ""
    return re.compile(f"{before}{re.escape(part)}{behind}")
