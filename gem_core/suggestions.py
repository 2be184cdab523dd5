"""The part of an error message that names the nearest right answers."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(wrong: str, names: Iterable[str]) -> str:
    """Return " Did you mean 'a' or 'b'?", at most three names whatever their case; nothing if none is near."""
    by_folded: dict[str, str] = {}
    for name in names:
        by_folded.setdefault(name.casefold(), name)
    found = difflib.get_close_matches(wrong[:200].casefold(), by_folded, n=3, cutoff=0.6)
    *others, last = [repr(by_folded[folded]) for folded in found] or [""]
    return f" Did you mean {', '.join(others)}{' or ' if others else ''}{last}?" if found else ""
