"""English words for games, fit to be shown to a child: the loader of the lists under ``data/words``.

A file is read when words of its length are first asked for, and then kept for the whole process. ``SOURCES.md`` beside
the lists says where they come from and how they were made.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

LENGTHS = range(2, 21)
"""Lengths of words that there are lists of."""

_LONGEST_SPACED = 1_000  # characters
_FOLDER = Path(__file__).with_name("data") / "words"


class WordList(NamedTuple):
    """The words of one length, in lower case.

    Args:
        common: Words that everyone knows, sorted: what is asked for.
        nouns: Those of them that are nouns above all, sorted.
        every: All words, rare ones and inflected ones too, sorted.
        known: The same, for a quick look-up.
    """

    common: tuple[str, ...]
    nouns: tuple[str, ...]
    every: tuple[str, ...]
    known: frozenset[str]


_NONE = WordList((), (), (), frozenset())


@cache
def word_list(length: int) -> WordList:
    """Return the words of a length; of one outside ``LENGTHS`` there are none."""
    if length not in LENGTHS:
        return _NONE
    blocks = (_FOLDER / f"{length:02}.txt").read_text(encoding="ascii").split("\n\n")
    nouns, others, further = (block.split() for block in blocks)
    every = sorted(nouns + others + further)
    return WordList(tuple(sorted(nouns + others)), tuple(nouns), tuple(every), frozenset(every))


@cache
def words(length: int | None = None) -> tuple[str, ...]:
    """Return the common words of a length, or of every length, in alphabetical order."""
    if length is not None:
        return word_list(length).common
    return tuple(sorted(word for each in LENGTHS for word in word_list(each).common))


@cache
def nouns(length: int | None = None) -> tuple[str, ...]:
    """Return the common words that are nouns above all, of a length or of every length, in alphabetical order."""
    if length is not None:
        return word_list(length).nouns
    return tuple(sorted(word for each in LENGTHS for word in word_list(each).nouns))


def is_word(text: str) -> bool:
    """Whether a text is an English word of ``LENGTHS``, common or not, in any case."""
    return len(text) in LENGTHS and text.lower() in word_list(len(text)).known


def letters(text: str) -> str | None:
    """Read letters from a to z in any case, with white space between them or not, as capitals; None if there is more.

    White space is not looked for in a text of more than 1,000 characters.
    """
    if not text.isalpha() and len(text) <= _LONGEST_SPACED:
        text = "".join(text.split())
    return text.upper() if text.isascii() and text.isalpha() else None
