"""Short answers compared with accepted ones: exact match and token F1 after normalisation.

Source: the evaluation of SQuAD, arXiv:1606.05250, section 6.1, and the script published with it: lower case, without
punctuation, without the articles a, an and the, and with single spaces. Here letters and marks outside ASCII are
treated in the same way; for text in ASCII all is as there, so that scores can be compared. To the letter: points and
signs of numbers are punctuation, and 1.5 is the same as 15.
"""

from __future__ import annotations

import ast
import io
import json
import re
import string
import tokenize
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from gem_core.errors import GradingError

_ARTICLES = re.compile(r"\b(a|an|the)\b")
_MINUS = 0x2212
_LISTED = ("text", "value", "aliases", "normalized_aliases")
"""Where SQuAD (text) and TriviaQA (the others) keep accepted answers, in a mapping."""


class _Deletions(dict[int, int | None]):
    """For ``str.translate``: drops punctuation, found out character by character as they turn up."""

    def __missing__(self, code: int) -> int | None:
        character = chr(code)
        dropped = character in string.punctuation or unicodedata.category(character).startswith("P") or code == _MINUS
        self[code] = None if dropped else code
        return self[code]


_deletions = _Deletions()
_ascii = str.maketrans("", "", string.punctuation)


def normalized(text: str) -> str:
    """Return a text in the form in which answers are compared.

    A text of which nothing would be left, as "The The!", keeps its articles, or else its punctuation, so that it is
    right to itself and to no other.
    """
    if text.isascii():
        bare = text.translate(_ascii).lower()
    else:
        text = unicodedata.normalize("NFKC", text)
        bare = _folded(text.translate(_deletions))
    return " ".join(_ARTICLES.sub(" ", bare).split()) or " ".join(bare.split()) or " ".join(_folded(text).split())


class Scores(NamedTuple):
    """How an answer compares with the accepted ones.

    Args:
        exact: Whether it is one of them, after normalisation; an empty answer never is.
        f1: Harmonic mean of precision and recall of words, from 0 to 1: the best among them.
    """

    exact: bool
    f1: float


def scores(answer: str, accepted: Sequence[str]) -> Scores:
    """Return exact match and token F1 of an answer."""
    own = normalized(answer)
    golds = [normalized(text) for text in accepted]
    if own and own in golds:
        return Scores(True, 1.0)
    words = own.split()
    return Scores(False, max([_f1(words, gold.split()) for gold in golds], default=0.0))


def exact_match(answer: str, accepted: Sequence[str]) -> bool:
    """Tell whether an answer is one of those accepted, after normalisation; an empty one never is."""
    return scores(answer, accepted).exact


def token_f1(answer: str, accepted: Sequence[str]) -> float:
    """Return the share of words on which an answer and an accepted one agree, the best among them."""
    return scores(answer, accepted).f1


def accepted_answers(value: Any) -> list[str]:
    """Return the accepted answers that a row gives.

    Args:
        value: A text, a number or truth value, a list of these, a list written as text (in JSON, Python's way or
            NumPy's), or a mapping as SQuAD and TriviaQA have.

    Raises:
        GradingError: There is none, so that no verdict is possible.
    """
    try:
        found = [text for text in dict.fromkeys(_flat(value)) if text.strip()]
    except RecursionError:
        raise GradingError("the row's accepted answers are nested too deeply to be read") from None
    if not found:
        raise GradingError(f"the row has no accepted answer: {value!r:.100}")
    return found


def _f1(own: list[str], gold: list[str]) -> float:
    if set(own).isdisjoint(gold):
        return 0.0
    common = (Counter(own) & Counter(gold)).total()
    return 2 * common / (len(own) + len(gold))


def _folded(text: str) -> str:
    return unicodedata.normalize("NFKC", text.casefold())


def _flat(value: Any) -> list[str]:
    if isinstance(value, str):
        listed = _listed(value)
        return [value] if listed is None else _flat(listed)
    if isinstance(value, Mapping):
        return [text for key in _LISTED if key in value for text in _flat(value[key])]
    if isinstance(value, bool | int | float):
        return [str(value)]
    if hasattr(value, "tolist"):  # an array of NumPy
        return _flat(value.tolist())
    if isinstance(value, Sequence | set | frozenset):
        return [
            text for part in value if part is not None for text in ([part] if isinstance(part, str) else _flat(part))
        ]
    if value is None:
        return []
    raise GradingError(f"an accepted answer must be text or a list of texts, not a {type(value).__name__}")


def _listed(text: str) -> list[Any] | None:
    """Return the list that a text writes out, or None where it is no list."""
    text = text.strip()
    if not (text.startswith("[") and text.endswith("]")):
        return None
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = _python_list(text)
    return value if isinstance(value, list) else None


def _python_list(text: str) -> list[Any] | None:
    """Return a flat list in Python's form, or NumPy's, which has no commas: Python would join its texts into one."""
    found: list[Any] = []
    try:
        for token in tokenize.generate_tokens(io.StringIO(text[1:-1]).readline):
            if token.type in (tokenize.STRING, tokenize.NUMBER):
                found.append(ast.literal_eval(token.string))
            elif token.string.strip() and token.string != ",":
                return None
    except (tokenize.TokenError, SyntaxError, ValueError):
        return None
    return found or None
