"""Comparing texts as an audit does: without case, spacing and marks."""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache


def normal(text: str) -> str:
    """Return a text with small letters and single spaces."""
    return " ".join(unicodedata.normalize("NFKC", text).casefold().split())


def holds(text: str, part: str) -> bool:
    """Tell whether a normal text holds another one that is no piece of a longer word or number."""
    return bool(part) and _whole(part).search(text) is not None


@lru_cache(maxsize=4096)
def _whole(part: str) -> re.Pattern[str]:
    before = r"(?<![^\W_])(?<!\d[.,])" if part[0].isalnum() else ""
    behind = r"(?![^\W_])(?!\.\d)" if part[-1].isalnum() else ""
    return re.compile(f"{before}{re.escape(part)}{behind}")
