"""The screen of a terminal, for programs that draw: what is on it now, as text.

``pyte`` keeps the picture. What it does not know, or would fail at, is taken out of the output first; and since it
takes about a second for a megabyte, it sees only the end of what came at once. Nothing that a program asks its terminal
(its kind, the place of the cursor, its title) is answered: answers would be typed into whatever runs by then.
"""

from __future__ import annotations

import codecs
import copy
import re
from collections.abc import Callable
from typing import Any

import pyte
from pyte.charsets import VT100_MAP

MOST_AT_ONCE = 48_000
"""Bytes of a burst that are drawn: its end. A screen of 120x40 is filled ten times by so many."""

_MOST_COMBINING = 3
_MOST_HELD = 4096
_LINES = str.maketrans({chr(code): VT100_MAP[code] for code in range(0x5F, 0x7F)})

# What pyte draws wrongly or not at all: strings for the terminal, private and intermediate forms of CSI.
_TOKEN = re.compile(
    r"\x1b\[([<=>?]?+)([0-9;:]*+)([ -/]*+)([@-~])"
    r"|\x1b[\]PX^_k][^\x07\x1b]*+(?:\x07|\x1b\\)"
    r"|\x1b([()])(.)|\x1b[ -'*-/]++[0-~]|\x1b([0-OQ-WYZ\\`-jl-~])|[\x0e\x0f]|[\x80-\x9f]",
    re.DOTALL,
)
_MODES = re.compile(rb"\x1b\[\?[0-9;]{1,20}[hl]|\x1b[()][0AB]")
_ALTERNATE = (47, 1047, 1049)
_RESIZING = (3, 5, 40)
"""Modes that would change the width of the screen, or turn its colours."""


class Screen:
    """What a terminal shows.

    Args:
        columns: Its width.
        lines: Its height.
    """

    def __init__(self, columns: int = 120, lines: int = 40) -> None:
        self.columns = columns
        self.lines = lines
        self.clear()

    def clear(self) -> None:
        """Begin anew, with nothing on it."""
        self._picture = _Picture(self.columns, self.lines)
        self._stream = pyte.Stream(self._picture, strict=False)
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._held = ""
        self._drawing_lines = False
        self._main: tuple[Any, Any] | None = None
        self._application_keys = False
        self._waiting = bytearray()

    def feed(self, output: bytes) -> None:
        """Take what a program wrote; it is drawn when someone looks, of very much the end, with the modes before it."""
        self._waiting += output
        if len(self._waiting) > 4 * MOST_AT_ONCE:
            self._shorten()

    def text(self) -> str:
        """Return what it shows, a line for each of its lines, without white space at their ends and below the last."""
        self._flush()
        shown = [line.rstrip() for line in self._picture.display]
        return "\n".join(shown).rstrip("\n")

    @property
    def cursor(self) -> tuple[int, int]:
        """Line and column of the cursor, from 0."""
        self._flush()
        return self._picture.cursor.y, min(self._picture.cursor.x, self.columns - 1)

    @property
    def application_keys(self) -> bool:
        """Whether the program has asked for application cursor keys; see ``key_bytes``."""
        self._flush()
        return self._application_keys

    def _shorten(self) -> None:
        skipped = bytes(self._waiting[:-MOST_AT_ONCE])
        modes = dict.fromkeys(reversed(_MODES.findall(skipped)[-1000:]))
        self._waiting[:-MOST_AT_ONCE] = b"\x18" + b"".join(reversed(list(modes)[:100]))

    def _flush(self) -> None:
        if len(self._waiting) > MOST_AT_ONCE:
            self._shorten()
        waiting, self._waiting = bytes(self._waiting), bytearray()
        if waiting:
            self._feed(self._decoder.decode(waiting))

    def _feed(self, text: str) -> None:
        text = self._held + text
        text, self._held = _whole(text)
        position = 0
        for token in _TOKEN.finditer(text):
            self._draw(text[position : token.start()])
            position = token.end()
            if token[4] is not None:
                self._control(token[0], token[1], token[2], token[3], token[4])
            elif token[5] == "(":
                self._drawing_lines = token[6] == "0"
            elif token[7] is not None:
                self._send(token[0])
        self._draw(text[position:])

    def _draw(self, text: str) -> None:
        if text:
            self._send(text.translate(_LINES) if self._drawing_lines else text)

    def _control(self, whole: str, private: str, parameters: str, between: str, final: str) -> None:
        if between or private in ("<", "=", ">") or final in "nc":
            return
        if private != "?":
            if ":" not in parameters:
                self._send(whole)
            elif final == "m":
                self._send("\x1b[m")
            return
        if final not in "hl":
            if final in "JK":
                self._send(f"\x1b[{parameters}{final}")
            return
        for mode in (int(each) for each in parameters[:50].split(";") if each.isdigit() and len(each) < 6):
            self._mode(mode, final == "h")

    def _mode(self, mode: int, on: bool) -> None:
        if mode == 1:
            self._application_keys = on
        elif mode in _ALTERNATE:
            self._other_screen(on)
        elif mode not in _RESIZING:
            self._send(f"\x1b[?{mode}{'h' if on else 'l'}")

    def _other_screen(self, on: bool) -> None:
        picture = self._picture
        if on and self._main is None:
            self._main = (copy.deepcopy(picture.buffer), copy.copy(picture.cursor))
            picture.erase_in_display(2)
        elif not on and self._main is not None:
            picture.buffer, picture.cursor = self._main
            picture.margins = None
            self._main = None

    def _send(self, text: str) -> None:
        try:
            self._stream.feed(text)
        except Exception:  # noqa: BLE001 - whatever a hostile sequence makes pyte raise, it goes on behind it
            self._stream._initialize_parser()


def _whole(text: str) -> tuple[str, str]:
    """Split off a sequence at the end that is still to be completed."""
    start = text.rfind("\x1b", max(0, len(text) - _MOST_HELD))
    if start < 0:
        return text, ""
    if text[start:] == "\x1b":
        # Perhaps the end of a string for the terminal, ESC \\, of which the first half has come.
        before = text.rfind("\x1b", max(0, start - _MOST_HELD), start)
        if before >= 0 and text[before + 1] in "]PX^_k" and _TOKEN.match(text, before) is None:
            return text[:before], text[before:]
    if _COMPLETE.match(text, start) is None:
        return text[:start], text[start:]
    return text, ""


_COMPLETE = re.compile(
    r"\x1b(?:\[[0-?]*+[ -/]*+[^0-?\ -/]|[\]PX^_k][^\x07\x1b]*+[\x07\x1b]|[()*+\-./ #%].|[^\[\]PX^_k()*+\-./ #%])",
    re.DOTALL,
)


class _Picture(pyte.Screen):
    """pyte's screen without what costs more than it is worth."""

    _combining = 0

    def draw(self, data: str) -> None:
        """Draw characters; of those that are put on top of one another, a few."""
        if data.isascii():
            self._combining = 0
        else:
            data = "".join(self._without_heaps(data))
        super().draw(data)

    def _without_heaps(self, data: str) -> list[str]:
        kept = []
        for character in data:
            self._combining = self._combining + 1 if _is_combining(character) else 0
            if self._combining <= _MOST_COMBINING:
                kept.append(character)
        return kept

    def save_cursor(self) -> None:
        """Remember the cursor; the last places only."""
        del self.savepoints[:-10]
        super().save_cursor()

    def set_title(self, param: str) -> None:
        """Have no title."""

    set_icon_name: Callable[..., None] = set_title


def _is_combining(character: str) -> bool:
    return character > "\u02ff" and pyte.screens.wcwidth(character) <= 0
