"""Text of others in a terminal: escaped, so that it cannot move the cursor, and coloured only where that is wanted."""

from __future__ import annotations

import os
import re
import sys

import click

# Control characters but line feed and tab, marks that reorder or hide text, separators that some take for line ends,
# halves of characters, and tags.
_UNSAFE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\ud800-\udfff\U000e0000-\U000e0fff]"
)


def escaped(text: str) -> str:
    r"""Return text in which what a terminal or a reader would stumble over stands as its code, as in ``\x1b``."""
    return _UNSAFE.sub(lambda found: _code(found[0]), text)


def one_line(text: str, width: int | None = None) -> str:
    """Return escaped text in one line, cut to a width in characters."""
    if width is not None:
        text = text[: 2 * width + 1]
    plain = text.isascii() and text.isprintable()
    line = text if plain else escaped(text).replace("\n", "\\n").replace("\t", " ")
    return line if width is None or len(line) <= width else line[: max(width - 1, 0)] + "…"


class Paint:
    """Colours text, or leaves it as it is.

    Args:
        colours: Whether to.
    """

    def __init__(self, colours: bool) -> None:
        self.colours = colours

    def __call__(self, text: str, **style: object) -> str:
        """Return the text in a style of ``click.style``."""
        return click.style(text, **style) if self.colours and text else text  # type: ignore[arg-type]

    def foreign(self, text: str) -> str:
        """Return text of others, what had to be escaped in reverse."""
        return _UNSAFE.sub(lambda found: self(_code(found[0]), reverse=True), text)


def in_terminal() -> bool:
    """Whether standard output is a terminal."""
    return sys.stdout.isatty()


def wants_colours() -> bool:
    """Whether standard output is a terminal that should show colours; see no-color.org."""
    return in_terminal() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def _code(character: str) -> str:
    point = ord(character)
    return f"\\x{point:02x}" if point < 0x100 else f"\\u{point:04x}" if point < 0x10000 else f"\\U{point:08x}"
