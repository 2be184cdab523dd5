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
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from gem_core.errors import GradingError

_ARTICLES = re.compile(r"\b(a|an|the)\b")
_ARTICLE_WORDS = frozenset(("a", "an", "the"))
_MINUS = 0x2212
_WRAPPED = re.compile(
    r"\\(?:boxed|text|textbf|textit|textrm|mathrm|mathbf|emph)[ \t]*+\{(.*)\}|\${1,2}([^$]*)\${1,2}|\\\((.*)\\\)",
    re.DOTALL,
)
_MOST_WRAPS = 8
_LISTED = ("text", "value", "aliases", "normalized_aliases")
"""Where SQuAD (text) and TriviaQA (the others) keep accepted answers, in a mapping."""


class _Deletions(dict[int, int | None]):
    """For ``str.translate``: drops punctuation, found out character by character as they turn up."""

    def __missing__(self, code: int) -> int | None:
        character = chr(code)
        category = unicodedata.category(character)
        # Cf: what is not seen, as marks of direction and spaces without width, which copied texts are full of.
        dropped = character in string.punctuation or category[0] == "P" or category == "Cf" or code == _MINUS
        self[code] = None if dropped else code
        return self[code]


_deletions = _Deletions()
_PUNCTUATION = string.punctuation.encode()
_ascii = bytes(32 if chr(code).isspace() else ord(chr(code).lower()) if code < 128 else code for code in range(256))
"""For ``bytes.translate``: small letters, and every white space a space."""


def normalized(text: str) -> str:
    """Return a text in the form in which answers are compared.

    A text of which nothing would be left, as "The The!", keeps its articles, or else its punctuation, so that it is
    right to itself and to no other.
    """
    if text.isascii():
        bare = text.encode().translate(_ascii, _PUNCTUATION).decode()
        if bare.isprintable():  # then words end at white space alone
            words = bare.split()
            kept = " ".join([word for word in words if word not in _ARTICLE_WORDS])
            return kept or " ".join(words) or " ".join(_folded(text).split())
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


def unwrapped(answer: str) -> str:
    r"""Return an answer without the LaTeX around the whole of it, as ``\boxed{\text{Paris}}`` or ``$Paris$``."""
    for _ in range(_MOST_WRAPS):
        if answer[:1] not in ("\\", "$") or (match := _WRAPPED.fullmatch(answer)) is None:
            break
        inner = next(part for part in match.groups() if part is not None)
        if not _balanced(inner):  # two of them side by side
            break
        answer = inner.strip()
    return answer


def accepted_answers(value: Any) -> list[str]:
    """Return the accepted answers that a row gives.

    Args:
        value: A text, a number or truth value, a list of these, a list written as text (in JSON, Python's way or
            NumPy's), or a mapping as SQuAD and TriviaQA have.

    Raises:
        GradingError: There is none, so that no verdict is possible.
    """
    if isinstance(value, str) and value[:1].isalnum():
        return [value]  # the usual case: no list, and not empty
    try:
        found = [text for text in dict.fromkeys(_flat(value)) if text.strip()]
    except RecursionError:
        raise GradingError("the row's accepted answers are nested too deeply to be read") from None
    if not found:
        raise GradingError(f"the row has no accepted answer: {value!r:.100}")
    return found


def _f1(own: list[str], gold: list[str]) -> float:
    left: dict[str, int] = {}
    for word in gold:
        left[word] = left.get(word, 0) + 1
    common = 0
    for word in own:
        if left.get(word):
            left[word] -= 1
            common += 1
    return 2 * common / (len(own) + len(gold)) if common else 0.0


def _balanced(text: str) -> bool:
    depth = 0
    for mark in re.findall(r"[{}]", text):
        depth += 1 if mark == "{" else -1
        if depth < 0:
            return False
    return depth == 0


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
