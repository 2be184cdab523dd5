r"""Reads what stands in rows: matrices, transposed ones, and values with their conditions."""

from __future__ import annotations

import re
from collections.abc import Callable

from gem_math.grading_forms import Cases, Form, Group, Many, Matrix, Opaque, Words
from gem_math.grading_text import words_of
from gem_math.grading_tokens import UnreadableError, has_words, outer_brackets, text_inside

_MATRIX = re.compile(r"^\\begin\s*\{([pbB]?matrix|smallmatrix|array)\}(?:\s*\{[^{}]*\})?(.*)\\end\s*\{\1\}$", re.DOTALL)
_CASES = re.compile(r"^\\begin\s*\{([dr]?cases)\}(.*)\\end\s*\{\1\}$", re.DOTALL)
_ROW_END = re.compile(r"\\\\(?:\s*\[[^\]]*\])?|\\cr(?![a-zA-Z])")
_TRANSPOSED = re.compile(r"^(.*)\^\s*(?:\{\s*)?(?:T|\\top|\\intercal|\\text\s*\{\s*T\s*\})(?:\s*\})?$", re.DOTALL)
_CONDITION = re.compile(r"[,;\s]*\\text\s*\{[\s,;]*(if|for|when|where|otherwise|else)(?![A-Za-z])([^{}]*)\}")
_CONDITION_WORD = re.compile(r"^\s*(?:\\text\s*\{\s*(?:if|for|when|where)\s*\}|(?:if|for|when|where)(?![A-Za-z]))")

Read = Callable[[str], Form]


def read_table(text: str, read: Read) -> Form | None:
    """Return a matrix, or values with conditions; None where the text is neither.

    Args:
        text: The answer, after ``clean``.
        read: Reads what stands in a cell.

    Raises:
        UnreadableError: Its rows have different lengths.
    """
    if match := _TRANSPOSED.match(text):
        return _transposed(read(match[1].strip())) if match[1].strip()[-1:] in {")", "]", "}", "e"} else None
    found = outer_brackets(text)
    inner = found[1].strip() if found is not None and found[0] in {"(", "["} else text
    if match := _CASES.match(inner):
        return _cases(match[2], read)
    match = _MATRIX.match(inner)
    if match is None or r"\begin" in match[2]:
        return Opaque(text, has_words(text)) if r"\begin" in text else None
    rows = [row for row in _ROW_END.split(match[2].replace(r"\hline", "")) if row.strip()]
    cells = tuple(tuple(read(cell) for cell in row.split("&")) for row in rows)
    if not cells or len({len(row) for row in cells}) != 1:
        raise UnreadableError
    return Matrix(cells, text)


def _transposed(form: Form) -> Form | None:
    if isinstance(form, Matrix):
        return Matrix(tuple(zip(*form.rows, strict=True)), "")
    if isinstance(form, Group) and not any(isinstance(item, Group) for item in form.items):
        return Matrix(tuple((item,) for item in form.items), "")
    return None


def _cases(body: str, read: Read) -> Form:
    """Return values with conditions; equations without any are a list of them."""
    rows = [_row(row) for row in _ROW_END.split(body) if row.strip()]
    if not rows:
        raise UnreadableError
    if any(condition is not None for _, condition in rows):
        return Cases(tuple((read(value), _condition(condition, read)) for value, condition in rows))
    items = [read(value) for value, _ in rows]
    return Many(tuple(part for item in items for part in (item.items if isinstance(item, Many) else (item,))))


def _row(row: str) -> tuple[str, str | None]:
    value, mark, condition = row.partition("&")
    if not mark and (match := _CONDITION.search(row)) is not None:
        words = match[1] if match[1] in {"otherwise", "else"} else match[2]
        value, condition, mark = row[: match.start()], f"{words} {row[match.end() :]}", "&"
    condition = condition.replace("&", " ").strip(" ,.;")
    return value.strip(" ,.;"), condition if mark and condition else None


def _condition(text: str | None, read: Read) -> Form | None:
    if text is None:
        return None
    if words_of(text) in {"otherwise", "else", "if otherwise"}:
        return Words("otherwise", text)
    text = text_inside(text) if text.startswith(r"\text") and text.count("{") == 1 and text.endswith("}") else text
    return read(_CONDITION_WORD.sub("", text).strip(" ,.;"))
