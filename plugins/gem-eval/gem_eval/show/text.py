"""Text for a terminal: what others wrote is escaped, so that it cannot move the cursor or hide anything."""

from __future__ import annotations

import re

from click import style

# Control characters but line feed and tab, marks that reorder or hide text, separators that some take for line ends,
# halves of characters, and tags.
_UNSAFE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e0fff]"
)


def escaped(text: str) -> str:
    r"""Return text in which what a terminal would obey or not show stands as its code, as in ``\x1b``."""
    return _UNSAFE.sub(lambda found: _code(found[0]), text)


def highlighted(text: str) -> str:
    """Return escaped text with the codes in reverse video."""
    return _UNSAFE.sub(lambda found: style(_code(found[0]), reverse=True), text)


def one_line(text: str, width: int | None = None) -> str:
    """Return escaped text in one line, cut to a width in characters."""
    if width is not None:
        text = text[: 2 * width + 1]
    line = escaped(text).replace("\n", "\\n").replace("\t", " ")
    return line if width is None or len(line) <= width else line[: max(width - 1, 0)] + "…"


def heading(text: str) -> str:
    """Return the heading of a section."""
    return style(text, bold=True)


def dim(text: str) -> str:
    """Return text in a dim style."""
    return style(text, dim=True)


def rule(title: str) -> str:
    """Return a line with a title, which separates turns."""
    return style(f"── {title} ".ljust(72, "─"), fg="blue")


def _code(character: str) -> str:
    point = ord(character)
    return f"\\x{point:02x}" if point < 0x100 else f"\\u{point:04x}" if point < 0x10000 else f"\\U{point:08x}"
