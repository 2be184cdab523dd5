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


def one_slip(written: str, name: str) -> bool:
    """Tell whether two names differ, except in case, by one extra, missing or wrong letter or two exchanged."""
    written, name = written.casefold(), name.casefold()
    if written == name:
        return True
    if min(len(written), len(name)) < 5:
        return False
    while written and name and written[0] == name[0]:
        written, name = written[1:], name[1:]
    while written and name and written[-1] == name[-1]:
        written, name = written[:-1], name[:-1]
    return max(len(written), len(name)) <= 1 or (len(written) == 2 and written == name[::-1])
