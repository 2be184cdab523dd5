"""Splitting text into the words that are indexed: lower case, without accents, in the singular."""

from __future__ import annotations

import re
import unicodedata

_IDEOGRAPHS = "\u3040-\u30ff\u3400-\u4dbf\u4e00-\u9fff\uac00-\ud7af"
# Scripts that put no spaces between words are indexed by the letter.
_WORD = re.compile(rf"[{_IDEOGRAPHS}]|[^\W_{_IDEOGRAPHS}]+")
_MARKS = re.compile("[\u0300-\u036f]")
_THOUSANDS = re.compile(r",(?<=\d,)(?=\d{3}(?!\d))")
_MAX_WORD = 64  # letters
_MAX_QUERY_WORDS = 64

STOP_WORDS = frozenset(  # one word a line would fill three screens
    "a about after all also am an and any are as at be been before being but by can could did do does doing for from "  # noqa: SIM905
    "had has have having he her here hers him his how i if in into is it its me more most my no not of on or our out "
    "s she so some such t than that the their them then there these they this those through to too under until up us "
    "was we were what when where which while who whom whose why will with would you your".split()
)
"""Words that are left out of a query that has others."""


def split_words(text: str) -> list[str]:
    """Return the words of a text in order, not yet in the singular."""
    text = _THOUSANDS.sub("", text)
    if not text.isascii():
        text = unicodedata.normalize("NFC", _MARKS.sub("", unicodedata.normalize("NFKD", text)))
    return _WORD.findall(text.casefold())


def singular(word: str) -> str:
    """Return a word without the ending of a plural.

    Source: the S stemmer of D. Harman, "How effective is suffixing?", 1991.
    """
    word = word[:_MAX_WORD]
    if len(word) < 4 or not word.endswith("s"):
        return word
    if word.endswith("ies") and word[-4] not in "ae":
        return f"{word[:-3]}y"
    if word.endswith("es") and word[-3] not in "aeo":
        return word[:-1]
    return word if word.endswith(("us", "ss")) else word[:-1]


def query_words(text: str) -> list[str]:
    """Return the different words of a query in order, at most 64.

    Stop words are kept only if there are no others, as in "The Who".
    """
    words = split_words(text)
    telling = [word for word in words if word not in STOP_WORDS]
    return list(dict.fromkeys(map(singular, telling or words)))[:_MAX_QUERY_WORDS]
