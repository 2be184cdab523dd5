r"""Takes the LaTeX of an answer apart: tokens, brackets, separators, the sides of a relation, names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache

_TOKEN = re.compile(
    r"\\begin\s*\{[a-zA-Z]+\*?\}|\\end\s*\{[a-zA-Z]+\*?\}|\\text\s*\{[^{}]*\}|\\[a-zA-Z]+|\\.|[{}()\[\]]"
    r"|\s*[,;]\s*|[<>=!]=|\s(?:and|or)(?=\s)|[^\\{}()\[\],;\s<>=!:]+|.",
    re.DOTALL,
)
# Brackets that match have the same word: those of an interval may be mixed.
_OPEN = {
    "{": "brace", "(": "interval", "[": "interval", r"\{": "set", r"\langle": "angle", r"\lfloor": "floor",
    r"\lceil": "ceiling", "\\begin": "environment",
}  # fmt: skip
_CLOSE = {
    "}": "brace", ")": "interval", "]": "interval", r"\}": "set", r"\rangle": "angle", r"\rfloor": "floor",
    r"\rceil": "ceiling", "\\end": "environment",
}  # fmt: skip
_SIGNS = {
    "=": "=", "==": "=", "<": "<", ">": ">", "<=": "<=", ">=": ">=", r"\le": "<=", r"\ge": ">=", r"\ne": "!=",
    "!=": "!=", r"\in": "in",
}  # fmt: skip
_NAME_EXTRAS = re.compile(
    r"_\s*(?:\{[^{}]*\}|\\?\w+)|\^\s*\{\s*-1\s*\}(?=\s*\()|\\(?:text|overline|vec|overrightarrow|widehat|hat|bar|mathbb|mathcal)\s*(?=\{)"
    r"|\\(?:angle|triangle|measuredangle|max|min|alpha|beta|gamma|delta|theta|lambda|mu|phi|omega|sigma|tau|rho|pi"
    r"|ell|epsilon|Delta|Omega|Gamma|Sigma|Phi|circ|frac)(?![a-zA-Z])"
)
_NAME = re.compile(r"(?:[A-Za-z{}'|,:/\s]|(?<=[A-Za-z}])\s*\([-\w,\s.]*\)|\([A-Za-z,\s]+\))+")
_WORD_RUN = re.compile(r"(?<![\\A-Za-z])[A-Za-z]{3,}(?![A-Za-z])")
# Two ends, and no bracket between them.
_INTERVAL = re.compile(r"([\[\]])([^\[\](),;]*[,;][^\[\](),;]*)([\[\]])")
_NO_INDEX = re.compile(r"_\s*\{[^{}]*\}")


class UnreadableError(Exception):
    """The brackets do not match, or there are too many parts."""


def walk(text: str) -> Sequence[tuple[str, int]]:
    """Return the tokens of a text, each with the depth of brackets at which it stands.

    Raises:
        UnreadableError: Brackets do not match; round and square ones may, as in an interval.
    """
    return _walked(text)


@lru_cache(maxsize=64)  # one text is looked at for one thing after another
def _walked(text: str) -> Sequence[tuple[str, int]]:
    tokens: list[tuple[str, int]] = []
    waiting: list[str] = []
    for match in _TOKEN.finditer(text):
        token = kind = match[0]
        if token[0] == "\\" and token[-1] == "}":
            kind = "\\begin" if token.startswith("\\begin") else "\\end" if token.startswith("\\end") else token
        if kind in _CLOSE and (not waiting or waiting.pop() != _CLOSE[kind]):
            raise UnreadableError
        tokens.append((token, len(waiting)))
        if kind in _OPEN:
            waiting.append(_OPEN[kind])
    if waiting:
        raise UnreadableError
    return tokens


def split(text: str, separators: set[str]) -> list[str]:
    """Split a text at tokens outside all brackets."""
    pieces = [""]
    for token, depth in walk(text):
        bare = token.strip()
        if bare.startswith(r"\text") and bare.endswith("}"):
            inner = bare[bare.index("{") + 1 : -1].strip()
            bare = inner if inner in {"and", "or", ",", ", and", ", or"} else bare
            bare = bare.strip(", ") or ","
        if depth == 0 and bare in separators:
            pieces.append("")
        else:
            pieces[-1] += token
    return pieces


def sides_of(text: str) -> tuple[list[str], list[str]]:
    """Return the sides of a relation, and the signs between them."""
    sides, signs = [""], []
    for token, depth in walk(text):
        sign = _SIGNS.get(token) if depth == 0 else None
        if sign is None:
            sides[-1] += token
        else:
            signs.append(sign)
            sides.append("")
    return sides, signs


def outer_brackets(text: str) -> tuple[str, str, str] | None:
    """Return the brackets around a whole text and what is in them; None where it has none."""
    tokens = walk(text)
    if len(tokens) < 2 or tokens[0][0] not in _OPEN or tokens[-1][0] not in _CLOSE:
        return None
    if any(level == 0 for _, level in tokens[1:-1]):
        return None
    opening, closing = tokens[0][0], tokens[-1][0]
    return opening, text[len(opening) : len(text) - len(closing)], closing


def plain_brackets(text: str) -> str:
    """Return a text with the open ends of intervals as round brackets, where it has them turned, as in ]0, 1[."""
    found = list(_INTERVAL.finditer(text)) if "]" in text or "[" in text else []
    if not any(match[1] == "]" or match[3] == "[" for match in found) or "(" in _INTERVAL.sub("", text):
        return text
    return _INTERVAL.sub(
        lambda match: f"{'[' if match[1] == '[' else '('}{match[2]}{']' if match[3] == ']' else ')'}", text
    )


def has_no_brackets(text: str) -> bool:
    """Return whether there are no brackets but LaTeX's braces."""
    return not re.search(r"[(\[]|\\\{|\\langle", text)


def text_inside(text: str) -> str:
    r"""Return the words of a ``\text{}`` without it."""
    return re.sub(r"\\text\s*\{([^{}]*)\}", r"\1", text).strip()


def plain_name(name: str) -> str:
    """Return a name without white space and braces."""
    return re.sub(r"\s|\\text|[{}]", "", name)


def is_name(side: str) -> bool:
    """Return whether a side of a relation is a name, as x, f(x), a_1, angle ABC or (x, y), and no formula."""
    side = side.strip()
    if not side or len(side) > 60:
        return False
    rest = _NAME_EXTRAS.sub(" a ", side)
    return _NAME.fullmatch(rest) is not None and "\\" not in rest and side not in {"e", "i", r"\pi"}


def has_words(text: str) -> bool:
    """Return whether there are words in a formula, which a computer algebra system takes for products."""
    rest = re.sub(r"\\(?:begin|end|operatorname|mathbb|mathcal)\s*\{[^{}]*\}", " ", text)
    return r"\text" in rest or _WORD_RUN.search(_NO_INDEX.sub(" ", rest)) is not None
