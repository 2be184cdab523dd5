"""For gallery.py: draw an episode as an SVG whose frames follow each other; the last one stands where nothing moves.

The picture brings its own background, so that it looks the same on a light and on a dark page. It needs no script and
no font from elsewhere. What several frames have in common is written once.
"""

from __future__ import annotations

import base64
import re
import struct
import textwrap
from collections.abc import Iterable, Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape

MOST_BYTES = 40_000
WIDTH = 820
_MARGIN, _TOP, _LINE, _CHARACTER, _CELL = 24, 76, 19, 8.5, 36
_SECONDS, _LAST_SECONDS = 1.2, 3.6
_PANEL, _IMAGE, _LOG_LINES = 250, 280, 24
_COLOURS = {
    "": "#cbd5e1",
    "1": "#f8fafc",
    "2": "#64748b",
    "31": "#f87171",
    "32": "#4ade80",
    "33": "#facc15",
    "34": "#60a5fa",
    "35": "#e879f9",
    "36": "#22d3ee",
}
_TILES = {
    "": "#1e293b",
    "1": "#334155",
    "2": "#1e293b",
    "31": "#b91c1c",
    "32": "#15803d",
    "33": "#a16207",
    "34": "#1d4ed8",
    "35": "#7e22ce",
    "36": "#0e7490",
}
_WALL, _COVER = "#475569", "#64748b"
_GAP = 8
_AFTER_BOARD = re.compile(r"\s*$|turn \d|\S+ (?:to act|won|lost|drawn)\b")
_AFTER_NUMBERED = re.compile(r"(?! *\d| +-)")
_PAINTED = re.compile(r"\x1b\[(\d*)m")
_FRAME = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" aria-label="{label}">
<style>text{{font:14px Menlo,Consolas,"DejaVu Sans Mono",monospace;white-space:pre}}
.t{{font-size:16px;font-weight:bold;text-anchor:middle}}{styles}</style>
<rect width="{width}" height="{height}" rx="12" fill="#0f172a"/>
{content}
</svg>
"""


class Grid(NamedTuple):
    """How cells stand in the drawing of a game, as text.

    Args:
        width: Characters of a cell.
        left: Characters before the first cell.
        top: Lines before the first row.
    """

    width: int
    left: int = 0
    top: int = 0


GRIDS = {
    "Crosswords": Grid(3, 2, 1),
    "FifteenPuzzle": Grid(3),
    "Game2048": Grid(6),
    "Hangman": Grid(2, 1),
    "Minesweeper": Grid(2, 3, 1),
    "Sokoban": Grid(2),
    "Sudoku": Grid(2, 1, 1),
    "TicTacToe": Grid(3),
    "WordSearch": Grid(3, 2, 1),
    "Wordle": Grid(2, 1),
}
"""Games whose drawing is a grid of cells, drawn as tiles; others are drawn as the text that they are."""


class Frame(NamedTuple):
    """What is seen after a turn.

    Args:
        drawing: Text with colours of a terminal.
        heading: The number of the turn, and who acted.
        action: What was answered; empty at the beginning.
        reward: The reward of the turn; None at the beginning.
        feedback: What the environment said.
    """

    drawing: str
    heading: str
    action: str = ""
    reward: float | None = None
    feedback: str = ""


Piece = tuple[str, str]
"""Some characters, and the code of their colour."""


def card(title: str, player: str, frames: Sequence[Frame], grid: Grid | None = None) -> str:
    """Return an SVG of an episode; frames are left out until it is small enough."""
    for most in (12, 8, 5, 3, 2):
        picture = _card(title, player, spread(frames, most), grid)
        if len(picture.encode()) <= MOST_BYTES:
            return picture
    return _card(title, player, frames[-1:], grid)


def spread(frames: Sequence[Frame], most: int) -> list[Frame]:
    """Return at most so many frames: the first, the last, and some between them."""
    if len(frames) <= most:
        return list(frames)
    return [frames[place * (len(frames) - 1) // (most - 1)] for place in range(most)]


def _card(title: str, player: str, frames: Sequence[Frame], grid: Grid | None) -> str:
    drawings = [_drawn(frame.drawing, grid) for frame in frames]
    right = max(drawing.width for drawing in drawings) + 2 * _MARGIN
    beside = right + _PANEL <= WIDTH - _MARGIN and any(drawing.elements for drawing in drawings)
    lowest = max(drawing.height for drawing in drawings)
    left, top = (right, _TOP) if beside else (_MARGIN, _TOP + lowest + (_LINE if lowest else 0))
    told = [_panel(frame, left, top) for frame in frames] if lowest else _log(frames)
    height = max(_TOP + lowest, *(panel.height for panel in told)) + 2 * _MARGIN
    dots = [_dots(number, len(frames), height) for number in range(len(frames))]
    shown = [
        [*drawing.elements, *panel.elements, dot] for drawing, panel, dot in zip(drawings, told, dots, strict=True)
    ]
    player = player.replace("`", "")
    heading = _text(_MARGIN, 34, title, "#f8fafc", ' font-weight="bold"')
    heading += _text(WIDTH - _MARGIN, 34, player, "#94a3b8", ' text-anchor="end"')
    heading += f'<path d="M0 50H{WIDTH}" stroke="#1e293b" stroke-width="2"/>'
    content, styles = _animated(shown)
    return _FRAME.format(
        width=WIDTH,
        height=round(height),
        label=escape(f"{title}, played by {player}", {'"': "&quot;"}),
        styles=styles,
        content=f"{heading}\n{content}",
    )


class _Drawn(NamedTuple):
    """Elements, and how far they go: of a drawing its own size, of a panel where its last line ends."""

    elements: list[str]
    width: float
    height: float


def _animated(frames: Sequence[list[str]]) -> tuple[str, str]:
    """Return the elements of all frames, each once, and the styles that show each when its frames are there."""
    holders: dict[str, list[int]] = {}
    for number, elements in enumerate(frames):
        for element in dict.fromkeys(elements):
            holders.setdefault(element, []).append(number)
    groups: dict[tuple[int, ...], list[str]] = {}
    for element, numbers in holders.items():
        groups.setdefault(tuple(numbers), []).append(element)
    last = len(frames) - 1
    everywhere = tuple(range(last + 1))
    content = groups.pop(everywhere, [])
    hidden: list[str] = []
    moving: list[str] = []
    for name, (present, elements) in enumerate(groups.items()):
        content.append(f'<g class="f{name}">{"".join(elements)}</g>')
        if last not in present:
            hidden.append(f".f{name}")
        animation = f"animation:k{name} {_seconds(last):g}s step-end infinite"
        moving.append(f".f{name}{{{animation}}}{_keyframes(name, present, last)}")
    styles = f"{','.join(hidden)}{{visibility:hidden}}" if hidden else ""
    if moving:
        styles += f"@media(prefers-reduced-motion:no-preference){{{''.join(moving)}}}"
    return "\n".join(content), styles


def _seconds(last: int) -> float:
    return last * _SECONDS + _LAST_SECONDS


def _keyframes(name: int, numbers: Iterable[int], last: int) -> str:
    """Return when a group is seen, as steps of the whole time."""
    seen = set(numbers)
    changes = [number for number in range(last + 1) if number == 0 or (number in seen) != (number - 1 in seen)]
    steps = "".join(
        f"{100 * number * _SECONDS / _seconds(last):.4g}%{{visibility:{'visible' if number in seen else 'hidden'}}}"
        for number in changes
    )
    return f"@keyframes k{name}{{{steps}}}"


def _dots(current: int, count: int, height: float) -> str:
    """Return a row of dots that tells how far the episode is."""
    if count < 2:
        return ""
    radius, gap = 3, 14
    left = WIDTH / 2 - gap * (count - 1) / 2
    x = left + gap * current
    return f'<path d="M{left:g} {height - 18:g}H{left + gap * (count - 1):g}" stroke="#1e293b" stroke-width="2"/>' + (
        f'<circle cx="{x:g}" cy="{height - 18:g}" r="{radius}" fill="#38bdf8"/>'
    )


# The drawing.


def _drawn(drawing: str, grid: Grid | None) -> _Drawn:
    if drawing.startswith("data:image/png;"):
        return _image(drawing)
    lines = [_pieces(line) for line in drawing.split("\n")] if drawing else []
    if grid is None:
        return _lines_at(lines, _MARGIN, _TOP)
    texts = ["".join(text for text, _ in line) for line in lines]
    after = _AFTER_NUMBERED if grid.top else _AFTER_BOARD
    end = next((number for number in range(grid.top, len(texts)) if after.match(texts[number])), len(lines))
    elements: list[str] = []
    width = height = 0.0
    for line, text in zip(lines[grid.top : end], texts[grid.top : end], strict=True):
        if "--" in text:
            height += _GAP
            continue
        tiles, row_width = _tiles(line, _TOP + height, grid)
        elements += tiles
        width, height = max(width, row_width), height + _CELL
    rest = [line for line, text in zip(lines[end:], texts[end:], strict=True) if text and not text.startswith("turn ")]
    below = _lines_at(rest, _MARGIN, _TOP + height + _GAP)
    height += below.height + _GAP if rest else 0
    return _Drawn([*elements, *below.elements], max(width, below.width), height)


def _image(address: str) -> _Drawn:
    # Where a PNG says its size: https://www.w3.org/TR/png/#11IHDR
    width, height = struct.unpack(">II", base64.b64decode(address.partition(",")[2])[16:24])
    scale = min(_IMAGE / width, _IMAGE / height)
    shape = f'x="{_MARGIN}" y="{_TOP}" width="{width * scale:g}" height="{height * scale:g}"'
    return _Drawn([f'<image {shape} href="{address}"/>'], width * scale, height * scale)


def _tiles(row: list[Piece], y: float, grid: Grid) -> tuple[list[str], float]:
    """Return the tiles of a row, and how wide they are; a bar between cells is a gap."""
    marks = [(character, colour) for text, colour in row for character in text][grid.left :]
    elements, x, start = [], float(_MARGIN), 0
    while start < len(marks):
        if marks[start][0] == "|" or (marks[start][0] == " " and marks[start + 1 : start + 2] == [("|", "")]):
            x, start = x + _GAP, start + (1 if marks[start][0] == "|" else 2)
            continue
        cell = [mark for mark in marks[start : start + grid.width] if mark[0] != " "]
        if cell:
            elements.append(_tile("".join(character for character, _ in cell), cell[0][1], x, y))
        x, start = x + _CELL, start + grid.width
    return elements, x - _MARGIN


def _tile(text: str, colour: str, x: float, y: float) -> str:
    fill, ink = _TILES.get(colour, _TILES[""]), _COLOURS.get(colour, _COLOURS[""])
    if text == "██":
        fill, text = _WALL, ""
    elif text == "■":
        fill, text = _COVER if colour in ("", "1", "2") else fill, ""
    elif text in "·_.":
        text = ""
    elif fill != _TILES[""]:
        ink = "#f8fafc"
    size = _CELL - 4
    tile = f'<rect x="{x + 2:g}" y="{y + 2:g}" width="{size}" height="{size}" rx="5" fill="{fill}"/>'
    return tile + (_text(x + _CELL / 2, y + 24, text, ink, ' class="t"') if text else "")


def _lines_at(lines: Sequence[list[Piece]], left: float, top: float) -> _Drawn:
    elements, longest = [], 0
    for number, line in enumerate(lines):
        longest = max(longest, sum(len(text) for text, _ in line))
        if any(text.strip() for text, _ in line):
            spans = "".join(
                f'<tspan fill="{_COLOURS.get(colour, _COLOURS[""])}">{escape(text)}</tspan>' if colour else escape(text)
                for text, colour in line
            )
            place = f'x="{left:g}" y="{top + 14 + number * _LINE:g}" fill="{_COLOURS[""]}"'
            elements.append(f"<text {place}>{spans}</text>")
    return _Drawn(elements, longest * _CHARACTER, len(lines) * _LINE)


def _pieces(line: str) -> list[Piece]:
    """Split a line of a terminal into pieces of one colour."""
    pieces, colour = [], ""
    for number, part in enumerate(_PAINTED.split(line)):
        if number % 2:
            colour = "" if part in ("", "0") else part
        elif part:
            pieces.append((plain(part), colour))
    return pieces


# The panel.


Line = tuple[str, str]
"""A line, and its colour."""


def _panel(frame: Frame, left: float, top: float) -> _Drawn:
    """Return what a frame says in words, beside or below its drawing, and where it ends."""
    columns = int((WIDTH - left - _MARGIN) / _CHARACTER)
    return _written(_lines(frame, columns, 5 if columns < 60 else 14, 9), left, top)


def _log(frames: Sequence[Frame]) -> list[_Drawn]:
    """Return what is said up to each frame: of episodes without a drawing the last frame shows most of them."""
    lines: list[Line] = []
    panels = []
    for frame in frames:
        lines += [*([("", "")] if lines else []), *_lines(frame, int((WIDTH - 2 * _MARGIN) / _CHARACTER), 14, 8)]
        panels.append(_written(lines[-_LOG_LINES:], _MARGIN, _TOP))
    return panels


def _lines(frame: Frame, columns: int, most_of_action: int, most_of_feedback: int) -> list[Line]:
    lines: list[Line] = [(frame.heading, "#94a3b8")]
    lines += [(line, "#22d3ee") for line in wrapped(frame.action, columns, most_of_action)]
    if frame.reward is not None:
        colour = "#4ade80" if frame.reward > 0 else "#f87171" if frame.reward < 0 else "#94a3b8"
        lines.append((f"reward {frame.reward:.4g}", colour))
    return [*lines, *((line, "#cbd5e1") for line in wrapped(frame.feedback, columns, most_of_feedback))]


def _written(lines: Sequence[Line], left: float, top: float) -> _Drawn:
    elements = [
        _text(left, top + 14 + number * _LINE, line, colour) for number, (line, colour) in enumerate(lines) if line
    ]
    return _Drawn(elements, WIDTH - left - _MARGIN, top + len(lines) * _LINE)


def wrapped(text: str, columns: int, most: int) -> list[str]:
    """Return text in lines of so many columns; what goes beyond ``most`` lines is cut off with a mark."""
    lines = [
        piece
        for line in text.strip().split("\n")
        for piece in textwrap.wrap(plain(line), columns, drop_whitespace=True, replace_whitespace=False) or [""]
    ]
    if len(lines) > most:
        lines = [*lines[: most - 1], "…"]
    return lines if text.strip() else []


def plain(text: str) -> str:
    """Return text without characters that XML cannot hold."""
    return "".join(character for character in text if character.isprintable() or character == "\t")


def _text(x: float, y: float, text: str, colour: str, more: str = "") -> str:
    return f'<text x="{x:g}" y="{y:g}" fill="{colour}"{more}>{escape(plain(text))}</text>'
