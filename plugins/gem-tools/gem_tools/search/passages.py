"""Passages and queries, and how passages are shown: numbered, and cut to a budget."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

MAX_QUERY_CHARS = 1000
"""Longer queries are cut."""

MAX_TOP_K = 100

LEAST_CHARS = 40
"""A passage is left out rather than cut shorter than this."""

_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_SURROGATES = re.compile(r"[\ud800-\udfff]")


@dataclass(frozen=True)
class Passage:
    """A piece of text that was found; a field that the source does not give is empty."""

    id: str
    title: str
    text: str
    score: float | None = None
    url: str = ""


def cleaned_query(text: str) -> tuple[str, bool]:
    """Return the part of an agent's text that is searched for, as one line, and whether there was more."""
    # Cut before any other work, to four times the limit: runs of white space are joined below.
    text = text.strip()
    line = " ".join(printable(text[: 4 * MAX_QUERY_CHARS]).split())
    cut = len(line) > MAX_QUERY_CHARS or len(text) > 4 * MAX_QUERY_CHARS
    return line[:MAX_QUERY_CHARS].rstrip(), cut


def printable(text: str) -> str:
    """Return text without control characters and lone surrogates, which files and servers refuse."""
    return _SURROGATES.sub("\ufffd", _CONTROLS.sub(" ", text))


def one_line(text: str, most: int = 200) -> str:
    """Return text in one printable line, cut after so many characters."""
    line = " ".join(printable(text).split())
    return line if len(line) <= most else f"{line[:most]}…"


def rendered(passages: Sequence[Passage], max_chars: int) -> str:
    """Return passages as text, each under its number and title.

    If they are too long, the longest are cut first; if even 40 characters of each are too much, the last ones are left
    out.
    """
    shown = [(_heading(number, passage), printable(passage.text).strip()) for number, passage in enumerate(passages, 1)]
    while shown:
        left = max_chars - sum(len(heading) + 2 for heading, _ in shown) + 2
        most = _most_each([len(text) for _, text in shown], left)
        if most >= LEAST_CHARS:
            return "\n\n".join(heading + _cut(text, most) for heading, text in shown)
        if len(shown) == 1:
            return shown[0][0][:max_chars]
        shown.pop()
    return ""


def _most_each(lengths: Sequence[int], left: int) -> int:
    """Return the length to which texts must be cut so that all together fit."""
    for place, length in enumerate(sorted(lengths)):
        share = left // (len(lengths) - place)
        if length > share:
            return share
        left -= length
    return max([LEAST_CHARS, *lengths])


def _heading(number: int, passage: Passage) -> str:
    title = one_line(passage.title)
    return f"[{number}] {' '.join(filter(None, [title, passage.url and f'({passage.url})'])) or 'Without a title'}\n"


def _cut(text: str, most: int) -> str:
    if len(text) <= most:
        return text
    # At the end of a word, unless that gives up too much.
    space = text.rfind(" ", most // 2, most)
    return f"{text[: space if space > 0 else most - 1]}…"
