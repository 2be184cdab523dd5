"""Output of commands as a person at a terminal would read it: what was overwritten is gone, what steers is not shown.

Time and memory grow with the length of the output alone, whatever it holds: nothing here waits for the end of a
sequence that never ends, and no sequence makes more lines than the output has characters.
"""

from __future__ import annotations

import re

_MOST_COLUMN = 500
"""Columns that a cursor can be sent to; printed lines may be of any length."""

_LONGEST = 4096
"""Characters of the longest line that is overwritten; a terminal would have wrapped it long before, and kept it."""

# Strings for the terminal (titles, clipboards, links) end at the line's end at the latest, though a real terminal would
# swallow everything behind one that is never ended.
_IGNORED = re.compile(
    r"\x1b\[[0-?]*+[ -/]++[@-~]?+|\x1b\[[0-?]*+(?=[^ -~]|\Z)"
    r"|\x1b[\]PX^_][^\x07\x1b\n]*+(?:\x07|\x1b\\)?"
    r"|\x1b[ -/]++[0-~]?+|\x1b[0-OQ-WYZ\\`-~]"
)
_CONTROLS = re.compile(r"[\x00-\x07\x0e-\x1a\x1c-\x1f\x7f\x80-\x9f]")
_COLOURS = re.compile(r"\x1b\[[0-9;:]*+m")
_TOKEN = re.compile(r"\x1b\[([0-?]*+)([@-~])|[\n\r\b\t\x0b\x0c]|[^\x1b\n\r\b\t\x0b\x0c]++|\x1b")
_ALTERNATE = re.compile(r"\x1b\[\?(?:1049|1047|47)([hl])")
_MOVES = re.compile(r"[\r\b\x0b\x0c]|\x1b\[[0-?]*+[A-LPSTXf-hl`d]")


def plain_text(output: str) -> str:
    """Return the text that stays on the screen and above it.

    Lines are not wrapped, and end without white space from overwriting. Erasing the screen begins a new page below what
    was there, so that nothing printed is lost. What a full-screen program drew on the other screen is left out, as it
    is when such a program ends.
    """
    output = output.replace("\r\n", "\n")
    if "\x1b" in output:
        output = _main_screen(_COLOURS.sub("", output))
        output = _IGNORED.sub("", output)
    output = _CONTROLS.sub("", output)
    if _MOVES.search(output) is None:
        return output.replace("\x1b", "")
    return _Page().write(output)


def _main_screen(output: str) -> str:
    """Return the output without what was drawn on the alternate screen and cleared when it was left."""
    kept, position, alternate = [], 0, False
    for switch in _ALTERNATE.finditer(output):
        if switch[1] == "h" and not alternate:
            kept.append(output[position : switch.start()])
            alternate = True
        elif switch[1] == "l":
            if not alternate:
                kept.append(output[position : switch.start()])
            alternate = False
        else:
            continue
        position = switch.end()
    # A program that was killed in there has left its picture.
    kept.append(output[position:])
    return "".join(kept)


class _Page:
    """Lines that a cursor moves over; only those that were moved on are taken apart."""

    def __init__(self) -> None:
        self._lines: list[str] = [""]
        self._row = 0
        self._column = 0
        self._top = 0  # first row of the page, which absolute positions count from
        self._tall = 40

    def write(self, output: str) -> str:
        for token in _TOKEN.finditer(output):
            if token[2] is not None or token[0] in "\r\b":
                self._leave_long_line()
            if token[2] is not None:
                self._steer(token[1], token[2])
                continue
            text = token[0]
            if text == "\n" or text == "\x0b" or text == "\x0c":
                self._to(self._row + 1, 0)
            elif text == "\r":
                self._column = 0
            elif text == "\b":
                self._column = max(0, self._column - 1)
            elif text == "\t":
                self._tab()
            elif text != "\x1b":
                self._print(text)
        return "\n".join(self._lines)

    def _leave_long_line(self) -> None:
        if len(self._lines[self._row]) > _LONGEST:
            self._lines.insert(self._row + 1, "")
            self._row, self._column = self._row + 1, 0

    def _print(self, text: str) -> None:
        line, column = self._lines[self._row], self._column
        if column == len(line):
            self._lines[self._row] = line + text
        elif column > len(line):
            self._lines[self._row] = line.ljust(column) + text
        else:
            self._lines[self._row] = line[:column] + text + line[column + len(text) :]
        self._column = column + len(text)

    def _tab(self) -> None:
        line = self._lines[self._row]
        if self._column >= len(line):
            self._print("\t")
        else:
            self._column = min(len(line), self._column // 8 * 8 + 8)

    def _to(self, row: int, column: int) -> None:
        self._row = max(self._top, min(row, max(len(self._lines), self._top + self._tall - 1)))
        while self._row >= len(self._lines):
            self._lines.append("")
        self._column = max(0, min(column, _MOST_COLUMN))

    def _steer(self, parameters: str, final: str) -> None:
        numbers = [int(each[:4]) if each.isdigit() else 0 for each in parameters[:50].split(";")]
        first = numbers[0] or 1
        if final == "K":
            self._erase_in_line(numbers[0])
        elif final == "J":
            self._erase_in_page(numbers[0])
        elif final == "P":
            line = self._lines[self._row]
            self._lines[self._row] = line[: self._column] + line[self._column + first :]
        else:
            self._move(final, first, numbers[1] if len(numbers) > 1 and numbers[1] else 1)

    def _move(self, final: str, first: int, second: int) -> None:
        row, column = self._row, self._column
        if final in "AF":
            # No further than the screen, as a terminal would not either.
            self._to(max(row - first, len(self._lines) - self._tall), 0 if final == "F" else column)
        elif final in "BE":
            self._to(max(row, min(row + first, self._top + self._tall - 1)), 0 if final == "E" else column)
        elif final in "CD":
            column = column + first if final == "C" else column - first
            self._column = max(0, min(column, max(self._column, _MOST_COLUMN)))
        elif final in "G`":
            self._column = min(first - 1, _MOST_COLUMN)
        elif final == "d":
            self._to(self._top + min(first, self._tall) - 1, column)
        elif final in "Hf":
            self._to(self._top + min(first, self._tall) - 1, second - 1)

    def _erase_in_line(self, how: int) -> None:
        line, column = self._lines[self._row], self._column
        if how == 0:
            self._lines[self._row] = line[:column]
        elif how == 1:
            self._lines[self._row] = " " * min(column + 1, len(line)) + line[column + 1 :]
        else:
            self._lines[self._row] = ""

    def _erase_in_page(self, how: int) -> None:
        if how == 0:
            self._lines[self._row] = self._lines[self._row][: self._column]
            del self._lines[self._row + 1 :]
        elif how >= 2:
            self._new_page()

    def _new_page(self) -> None:
        while self._lines and not self._lines[-1].strip():
            self._lines.pop()
        self._lines.append("")
        self._top = self._row = len(self._lines) - 1
        self._column = 0
