"""Search of the text of episodes, one after another: nothing is kept, and what reads the results may stop."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

from gem_eval.show.text import escaped
from gem_eval.text_search import found_in
from gem_eval.viewing.table import TableRow, row_data

MOST_FOUND = 1000
"""The search stops with so many."""

_PROGRESS_S = 0.15
_BEFORE, _AFTER = 20, 140


def search(places: Sequence[TableRow], text: str) -> Iterator[dict[str, Any]]:
    """Yield how far a search is, and what it found since: the rows of episodes with the text, each with an excerpt.

    Args:
        places: The episodes, in the order of the search.
        text: What is looked for in observations, responses and infos; case does not count.
    """
    found: list[dict[str, Any]] = []
    count, due = 0, 0.0
    for done, place in enumerate(places):
        if time.monotonic() >= due:
            yield {"done": done, "of": len(places), "found": found}
            found, due = [], time.monotonic() + _PROGRESS_S
        excerpt = _excerpt(place, text) if text else None
        if excerpt is not None:
            found.append({**row_data(place), "excerpt": excerpt})
            count += 1
            if count == MOST_FOUND:
                yield {"done": done + 1, "of": len(places), "found": found, "full": True}
                return
    yield {"done": len(places), "of": len(places), "found": found, "full": False}


def _excerpt(place: TableRow, text: str) -> str | None:
    """Return the text with what stands around it; None where an episode does not hold it, or is damaged."""
    piece = found_in(place.run.run, place.row, text)
    if piece is None:
        return None
    at = max(piece.casefold().find(text.casefold()), 0)
    start = max(at - _BEFORE, 0)
    return escaped(("…" if start else "") + piece[start : at + len(text) + _AFTER].strip())
