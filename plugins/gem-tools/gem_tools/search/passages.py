"""Passages, what may be asked for them, and how they are shown: numbered, and cut to a budget."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from gem_core.errors import ArgumentError

MAX_QUERY_CHARS = 1000
"""What is read of a query; more words find nothing more."""

MAX_TOP_K = 100

_LEAST_CHARS = 40
"""A passage that would be cut shorter than this is left out."""

_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_SURROGATES = re.compile(r"[\ud800-\udfff]")


@dataclass(frozen=True)
class Passage:
    """A piece of text that was found.

    Args:
        id: Of the passage in its corpus; empty where the source gives none.
        title: What it is about; may be empty.
        text: What it says.
        score: How well it fits the query, where the source says so.
        url: Where it stands; empty for a local corpus.
    """

    id: str
    title: str
    text: str
    score: float | None = None
    url: str = ""


class Query(NamedTuple):
    """A query that can be sent.

    Args:
        text: One line without control characters and broken Unicode; empty where nothing was asked.
        cut: Whether the agent wrote more.
    """

    text: str
    cut: bool


def cleaned_query(text: str) -> Query:
    """Return what is used of an agent's query, which may be any text at all."""
    # Longer than what is used, so that leading white space leaves enough, and bounded before any work is done.
    shortened = text.lstrip()[: 4 * MAX_QUERY_CHARS]
    words = " ".join(printable(shortened).split())
    cut = len(words) > MAX_QUERY_CHARS or len(text.strip()) > 4 * MAX_QUERY_CHARS
    return Query(words[:MAX_QUERY_CHARS].rstrip(), cut)


def printable(text: str) -> str:
    """Return text without control characters and lone surrogates, which no file and no server takes."""
    return _SURROGATES.sub("\ufffd", _CONTROLS.sub(" ", text))


class Budget:
    """How much an agent is given to read.

    Args:
        max_chars: Most characters of all passages together, titles included.
        max_tokens: Most tokens of the same; needs a tokenizer.
        tokenizer: A function that returns the tokens of a text, or an object whose ``encode`` does.

    Raises:
        ArgumentError: A limit is not positive, or there is nothing to count tokens with.
    """

    def __init__(self, max_chars: int, max_tokens: int | None = None, tokenizer: Any = None) -> None:
        if type(max_chars) is not int or max_chars < _LEAST_CHARS:
            raise ArgumentError(f"max_chars must be a whole number from {_LEAST_CHARS} up, not {max_chars!r}")
        if max_tokens is not None and (type(max_tokens) is not int or max_tokens < 1):
            raise ArgumentError(f"max_tokens must be a positive whole number or None, not {max_tokens!r}")
        if max_tokens is not None and tokenizer is None:
            raise ArgumentError("max_tokens needs a tokenizer to count with: pass tokenizer=…")
        encode = getattr(tokenizer, "encode", tokenizer)
        if tokenizer is not None and not callable(encode):
            raise ArgumentError(f"tokenizer must be a function or have a method 'encode', not {tokenizer!r}")
        self.max_chars = max_chars
        self.max_tokens = max_tokens
        self._encode: Callable[[str], Sequence[Any]] | None = encode

    def fits(self, text: str) -> bool:
        """Tell whether a text is within both limits."""
        if len(text) > self.max_chars:
            return False
        return self.max_tokens is None or self._encode is None or len(self._encode(text)) <= self.max_tokens


def rendered(passages: Sequence[Passage], budget: Budget) -> str:
    """Return passages as text, each under its number and title.

    What is too long is cut where it is longest, so that short passages stay whole; where even that is too much, the
    last ones are left out.
    """
    # Never work through megabytes of which nothing can be shown.
    passages = [replace(passage, text=printable(passage.text[: budget.max_chars + 1]).strip()) for passage in passages]
    for count in range(len(passages), 0, -1):
        kept = passages[:count]
        if budget.fits(whole := _joined(kept, None)):
            return whole
        text = _cut_to_fit(kept, budget)
        if text is not None:
            return text
    return _joined(passages[:1], 0)[: budget.max_chars] if passages and budget.max_tokens is None else ""


def _cut_to_fit(passages: Sequence[Passage], budget: Budget) -> str | None:
    """Return the passages cut to the longest length of a text at which all fit; None if none does."""
    low, high = _LEAST_CHARS, max(len(passage.text) for passage in passages)
    best = None
    while low <= high:
        middle = (low + high) // 2
        text = _joined(passages, middle)
        if budget.fits(text):
            best, low = text, middle + 1
        else:
            high = middle - 1
    return best


def _joined(passages: Sequence[Passage], most: int | None) -> str:
    return "\n\n".join(_shown(number, passage, most) for number, passage in enumerate(passages, start=1))


def _shown(number: int, passage: Passage, most: int | None) -> str:
    title = " ".join(printable(passage.title).split())[:200]
    heading = " ".join(filter(None, [title, f"({passage.url})" if passage.url else ""]))
    return f"[{number}] {heading or 'Without a title'}\n{_shortened(passage.text, most)}"


def _shortened(text: str, most: int | None) -> str:
    if most is None or len(text) <= most:
        return text
    # At the end of a word, unless that gives up too much.
    space = text.rfind(" ", most // 2, most + 1)
    return f"{text[: space if space > 0 else most]}…"
