"""The part of an error message that names the nearest right answers."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def nearest(wrong: str, names: Iterable[str], limit: int = 3) -> list[str]:
    """Return the names most like a wrong one, best first, whatever their case."""
    by_folded: dict[str, str] = {}
    for name in names:
        by_folded.setdefault(name.casefold(), name)
    found = difflib.get_close_matches(wrong[:200].casefold(), by_folded, n=limit, cutoff=0.6)
    return [by_folded[folded] for folded in found]


def did_you_mean(wrong: str, names: Iterable[str]) -> str:
    """Return " Did you mean 'a' or 'b'?" with a leading space, or nothing when no name is near."""
    found = [repr(name) for name in nearest(wrong, names)]
    if not found:
        return ""
    *others, last = found
    return f" Did you mean {', '.join(others)} or {last}?" if others else f" Did you mean {last}?"


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
