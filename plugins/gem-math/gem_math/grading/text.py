r"""Brings LaTeX, Unicode and plain notation into one spelling, and splits it at separators outside brackets.

Every function takes any text of the few thousand characters that an answer may have.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Sequence
from functools import lru_cache, partial

from gem_math.grading.words import WORDS

_SUPERSCRIPTS = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻ⁿ", "0123456789+-n", strict=True))
_SUBSCRIPTS = dict(zip("₀₁₂₃₄₅₆₇₈₉", "0123456789", strict=True))
_TRANSLATION = str.maketrans(WORDS["symbols"])
_SCRIPTS = re.compile(f"[{''.join(_SUPERSCRIPTS)}]+|[{''.join(_SUBSCRIPTS)}]+")
_ROOT = re.compile(r"([√∛])\s*(\(|\d+(?:\.\d+)?|[a-zA-Z])?")

_TEXT = re.compile(
    r"\\(?:text(?:bf|it|rm|sf|tt|sc|normal|up)?|mathrm|mathbf|mathit|mathsf|mathtt|mbox|hbox|emph|boldsymbol|bm"
    r"|operatorname\*?|mathop|underline|fbox|boxed|framebox|mathbin|mathord|ensuremath)\s*(?=\{)"
)
_PLAIN = {"{", "}", "$", "%"}  # these keep their backslash: they are LaTeX's visible signs
# Words of two letters or more, with hyphens: not commands, and not what follows a hyphen that may be a minus.
_PROSE = re.compile(r"(?<![\\A-Za-z_^])[^\W\d_]{2,}(?:(?:[-'\s]\s*)?[^\W\d_]{2,})*(?:'s)?")
_WORD = re.compile(r"[^\W_]+", re.UNICODE)


def clean(text: str) -> str:
    r"""Return an answer in the one spelling that the reader knows; ``\text{}`` is all that is left of text commands."""
    text = text.strip()
    for reading in SPELLINGS.values():
        text = reading(text)
    return text


def _sub(pattern: str, replacement: str | Callable[[re.Match[str]], str]) -> Callable[[str], str]:
    return partial(re.compile(pattern, re.DOTALL).sub, replacement)


def _unicode(text: str) -> str:
    if text.isascii():
        return text
    return unicodedata.normalize("NFKC", _ROOT.sub(_root, _SCRIPTS.sub(_scripts, text).translate(_TRANSLATION)))


def _stars(text: str) -> str:
    power = re.search(r"\w\s*\*\*\s*[\w({-]", text) and not text.startswith("**")
    return text.replace("**", " ^ " if power else " ")


def _without_marks_around(text: str) -> str:
    text = text.strip()
    around = len(text) > 2 and text[0] == text[-1] and text[0] in '"`' and text[0] not in text[1:-1]
    return text[1:-1].strip() if around else text


def _quotes(text: str) -> str:
    text = text.replace("``", '"')
    derivative = '"' not in text and re.search(r"[A-Za-z}]''", text)
    return text if derivative else text.replace("''", '"')


def _escaped_twice(text: str) -> str:
    rows = "matrix" in text or "array" in text or "cases" in text
    return text if rows else re.sub(r"\\\\(?=[a-zA-Z({\[%$])", r"\\", text)


def _index(match: re.Match[str]) -> str:
    return f"_{{{next(group for group in match.groups() if group is not None).strip()}}}"


def _unit_signs(text: str) -> str:
    """Write ohm, angstrom and what begins with micro behind a number, which have signs of mathematics, as words."""
    if not re.match(r"\s*-?[\d.]", text):
        return text
    names = {"Omega": "ohm", "AA": "angstrom"}
    text = _UNIT_SIGN.sub(lambda sign: rf"\text{{ {sign[1] or sign[3] or ''}{names[sign[2] or sign[4]]}}}", text)
    return _MICRO.sub(r"\\text{ micro\1}", text)


_GROUP = r"\\(?:text|mathrm|rm|textrm)\s*\{\s*"
_UNIT_SIGN = re.compile(
    rf"(?<=[\d}} ])(?:{_GROUP}([kM]?)\s*\\(Omega|AA)\s*\}}|(?:{_GROUP}([kM]?)\s*\}}\s*)?\\(Omega|AA)(?![a-zA-Z]))\s*$"
)
_MICRO = re.compile(rf"(?<=[\d}} ])(?:{_GROUP}\\mu\s*(?:\}}\s*{_GROUP})?|\\mu\s*{_GROUP})([a-zA-Z]{{1,3}})\s*\}}\s*$")


def worded(text: str) -> tuple[str, list[str]]:
    """Return what a text says in words, with # for each formula between them, and the formulas.

    What is no word belongs to a formula: signs, brackets and single letters; marks at its ends do not.
    """
    words, formulas, position = [], [], 0
    flat = re.sub(r"^\s*[aA]\s+(?=[^\W\d_]{3})", "", re.sub(r"\\text\s*\{([^{}]*)\}", r" \1 ", text))
    for match in [*_PROSE.finditer(flat), None]:
        between = flat[position : match.start() if match else None].strip(" .,:;!?\"'")
        if between:
            words.append("#")
            formulas.append(between)
        if match:
            words += _WORD.findall(unicodedata.normalize("NFKC", match[0]).casefold())
            position = match.end()
    return " ".join(words), formulas


def words_of(text: str) -> str:
    """Return what a text says, whatever its case, spaces and marks: its words, in lower case."""
    text = re.sub(r"\\text\s*\{([^{}]*)\}", r" \1 ", text)
    return " ".join(_WORD.findall(unicodedata.normalize("NFKC", text).casefold()))


def close_of(text: str, start: int) -> int:
    """Return the index of the brace that closes the one at ``start``; -1 where none does."""
    depth = 0
    for match in _BRACES.finditer(text, start):
        if match[0] == "{":
            depth += 1
        elif match[0] == "}":
            depth -= 1
            if depth == 0:
                return match.start()
    return -1


_BRACES = re.compile(r"\\[\\{}]|[{}]")


def _braced_comma(match: re.Match[str]) -> str:
    return f"{match[1]}{',' if len(match[2]) == 3 else '.'}{match[2]}"


def _scripts(match: re.Match[str]) -> str:
    if match[0][0] in _SUBSCRIPTS:
        return "_{" + "".join(_SUBSCRIPTS[sign] for sign in match[0]) + "}"
    power = "".join(_SUPERSCRIPTS[sign] for sign in match[0])
    return f"^{power}" if len(power) == 1 else f"^{{{power}}}"


def _root(match: re.Match[str]) -> str:
    root = r"\sqrt" if match[1] == "√" else r"\sqrt[3]"
    if match[2] is None:
        return root
    return root + (match[2] if match[2] == "(" else f"{{{match[2]}}}")


def _command(match: re.Match[str]) -> str:
    name: str | None = WORDS["commands"].get(match[1])
    if name is None:
        return match[0]
    if name in _PLAIN or name[0].isalpha():
        return "\\" + name + (" " if name[-1].isalpha() else "")
    return name


def _text_groups(text: str) -> str:
    r"""Turn every text command into ``\text``, and take it away from single signs and numbers."""
    if "\\" not in text:
        return text
    pieces: list[str] = []
    position = 0
    for match in _TEXT.finditer(text):
        if match.start() < position:
            continue
        brace = text.index("{", match.end() - 1)
        end = close_of(text, brace)
        if end < 0:
            break
        inner = text[brace + 1 : end]
        pieces.append(text[position : match.start()])
        pieces.append(_text_group(match[0], inner, text[end + 1 :]))
        position = end + 1
    pieces.append(text[position:])
    return "".join(pieces)


def _text_group(command: str, inner: str, behind: str) -> str:
    body = inner.strip()
    body = WORDS["commands"].get(body, body) if command.startswith(r"\operatorname") else body
    if re.match(r"\\(?:boxed|fbox|framebox|underline|ensuremath|mathbin|mathord|mathop)", command):
        return f" {clean(inner)} " if len(inner) < 10_000 else inner
    if (
        command.startswith((r"\operatorname", r"\mathrm", r"\mathop"))
        and body in _FUNCTIONS
        and _ARGUMENT.match(behind)
    ):
        # Without anything that it could be a function of it is a word, as in 18 \\mathrm{~min}.
        return f"\\{body} " if " " not in inner else f"\\text{{{body}}}"
    fonts = command.startswith((r"\mathbf", r"\bold", r"\bm", r"\mathit"))
    is_word = re.search(r"[^\W\d_]{2}|[^\W\d_]\s+[^\W\d_]", re.sub(r"\\[a-zA-Z]+", "", body)) is not None
    if (fonts and not is_word) or not _LETTER.search(body) or (not is_word and re.search(r"[=^_+*\\<>]", body)):
        return inner  # numbers and formulas in a font
    return f"\\text{{{inner}}}" if "{" not in inner else inner


_LETTER = re.compile(r"[^\W\d_]")
_ARGUMENT = re.compile(r"\s*[\w\\({\[^|]")
_FUNCTIONS = {"sin", "cos", "tan", "cot", "sec", "csc", "ln", "log", "exp", "arcsin", "arccos", "arctan", "sinh",
              "cosh", "tanh", "min", "max", "gcd", "lcm"}  # fmt: skip


_MARKS = {".", ",", ";", ":"}
_MAX_GROUPS = 50


def _strip(text: str) -> str:
    """Take away white space, marks at the end and empty groups around."""
    groups = 0
    while True:
        text = text.strip()
        # One mark ends a sentence; three dots say that something is left out.
        if text[-1:] in _MARKS and text[-2:-1] not in {".", "\\"}:
            text = text[:-1]
        elif text.startswith("{") and groups < _MAX_GROUPS and close_of(text, 0) == len(text) - 1:
            text, groups = text[1:-1], groups + 1
        else:
            return text


SPELLINGS: dict[str, Callable[[str], str]] = {
    "signs of Unicode": _unicode,
    "** as a power, or bold": _stars,
    "tags of HTML": _sub(r"</?(?:b|i|em|strong|u|span|p|code|math|mark)>", " "),
    "quotation marks around": _without_marks_around,
    "a brace on the left alone": _sub(
        r"\\left\s*\\\{\s*\\begin\s*\{(array|aligned|align\*?|gathered|matrix)\}(\s*\{[^{}]*\})?(.*?)\\end\s*\{\1\}\s*\\right\s*\.",
        r"\\begin{cases}\3\\end{cases}",
    ),
    r"\!": _sub(r"\\!\s*", ""),
    "1{,}000 and 2{,}5": _sub(r"(?<![\d}.])(\d+)\{,\}(\d+)(?![\d{])", _braced_comma),
    "{,} and {:}": _sub(r"\{([,:])\}", r"\1"),
    "two signs for a quotation mark": _quotes,
    "backslashes escaped twice": _escaped_twice,
    "ends of rows": _sub(r"^(?:\\\\(?=[\s\d&.-])\s*|&\s*)+|(?:\\\\\s*|\\newline\s*|&\s*)+$", ""),
    r"\not=": _sub(r"\\not\s*=", r"\\ne "),
    # Unless one goes on with a relation.
    "formulas on lines of their own": _sub(
        r"(\$|\\\)|\\\])[ \t]*\n\s*(\$\$?|\\\(|\\\[)(?!\s*(?:[=<>&]|\\(?:le|ge|approx|quad)))", r"\1, \2"
    ),
    "dollar signs": _sub(r"(?<!\\)\$", ""),
    "sizes of brackets": _sub(r"\\(?:left|right|middle|[bB]igg?[lrm]?)(?![a-zA-Z])[ ]?\.?", ""),
    r"\bigcup between sets": _sub(r"\\big(cup|cap)(?![a-zA-Z]|\s*_)", r"\\\1"),
    r"\( and \[": _sub(r"(?<!\\)\\[()\[\]]", " "),
    "white space": _sub(
        r"\\q?quad|\\(?:displaystyle|textstyle|scriptstyle|limits|nolimits|thinspace|enspace|medspace|nobreak)"
        r"(?![a-zA-Z])|\\[hv]space\*?\{[^{}]*\}|\\phantom\{[^{}]*\}|(?<!\\)\\[,;: >]|~|(?<!\\)\\(?=\s|$)|\s+",
        " ",
    ),
    "signs of units": _unit_signs,
    "other names of commands": _sub(r"\\([a-zA-Z]+)", _command),
    "primes": _sub(r"\^\s*(?:\\prime(?![a-zA-Z])|\{\s*(?:\\prime\s*)+\})", lambda match: "'" * match[0].count("prime")),
    # There is nothing that these could be functions of.
    "minutes and seconds": _sub(r"(?<=\d)\s*\\(min|sec)(?=\s*(?:$|[,;.)]))", r"\\text{\1}"),
    "text commands": _text_groups,
    # One spelling for E_1 and E_{1}, x_{\max} and x_\text{max}, behind what may be a name.
    "indices": _sub(
        r"(?<=[A-Za-z}'])\s*_\s*(?:\\text\s*\{([^{}]*)\}|\{\s*\\(?:text\s*\{([^{}]*)\}|(max|min|inf|sup))\s*\}"
        r"|\\(max|min|inf|sup)(?![a-zA-Z])|(\w))",
        _index,
    ),
    "ordinals": _sub(
        r"(?<=\d)\s*(?:\^\s*)?(?:\{\s*\\text\s*\{\s*(?:st|nd|rd|th)\s*\}\s*\}|\\text\s*\{\s*(?:st|nd|rd|th)\s*\}"
        r"|\{\s*(?:st|nd|rd|th)\s*\}|(?:st|nd|rd|th)(?=\s+[A-Za-z]{3}))",
        " ",
    ),
    "functions without a backslash": _sub(
        r"(?<![\\a-zA-Z])(sqrt|pi|infinity|infty|inf|sin|cos|tan|cot|sec(?=\s*[\w\\({^])|csc|arcsin|arccos|arctan|sinh"
        r"|cosh|tanh|ln|log|exp|theta|alpha|beta|gamma|lambda|cup|frac|times|cdot)(?![a-zA-Z])",
        lambda match: "\\" + {"infinity": "infty", "inf": "infty"}.get(match[1], match[1]),
    ),
    r"\choose": _sub(r"\{([^{}]{1,40})\\choose(?![a-zA-Z])([^{}]{1,40})\}", r"\\binom{\1}{\2}"),
    "fractions of units": _sub(
        r"\\frac\s*\{\s*\\text\s*\{([^{}]*)\}\s*\}\s*\{\s*\\text\s*\{([^{}]*)\}\s*\}", r"\\text{\1/\2}"
    ),
    "functions joined with x": _sub(r"(?<![\\a-zA-Z])(sin|cos|tan|cot|sec|csc|ln|log)(?=[xy](?![a-zA-Z]))", r"\\\1 "),
    "unit vectors": _sub(r"\\hat\s*\{\s*(?:\\mathbf\s*\{\s*)?\\?([ijk])(?:math)?\s*(?:\}\s*)?\}", r"\1"),
    "infinity as text": _sub(r"\\text\{\\infty\}", r"\\infty "),
    "marks and groups around": _strip,
}
"""Other spellings of one thing, in the order in which they are read; scripts/grader_readings.py tries each."""


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
