"""The screen of a terminal, and what programs do to it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_terminal.shell.screen import Screen


def shown(*pieces: bytes, columns: int = 20, lines: int = 5) -> str:
    """Return what a screen shows after some output."""
    screen = Screen(columns, lines)
    for piece in pieces:
        screen.feed(piece)
        screen.text()
    return screen.text()


@pytest.mark.parametrize(
    ("output", "text"),
    [
        (b"hello\r\nworld\r\n", "hello\nworld"),
        (b"shell\x1b[?1049h\x1b[Hediting\x1b[?1049l$", "shell$"),
        (b"\x1b(0lqk\x1b(Bq", "┌─┐q"),
        (b"\x1b]0;title\x07a\x1b]0;t\x1b\\b\x1bPq1\x1b\\c\x1b_x\x1b\\d", "abcd"),
        (b"\x1b[>4;2m\x1b[?1m\x1b[!pa\x1b[2 qb\x1b[38:5:9mc\x1b[?2004hd", "abcd"),
        (b"\x1b[c\x1b[6n\x1b[>c\x1b[8;100;300t\x1b[?3h\x1b[?40hx", "x"),
        (b"\x1b[99999999999999999999999Cx\x1b[1m", " " * 19 + "x"),
    ],
)
def test_screen_shows_what_a_terminal_would(output: bytes, text: str) -> None:
    """Text, the other screen, line drawing and what pyte would fail at, in one piece and byte by byte."""
    assert shown(output) == text
    assert shown(*(output[place : place + 1] for place in range(len(output)))) == text


def test_screen_says_where_the_cursor_is() -> None:
    """Line and column count from 0, and the column stays on the screen."""
    screen = Screen(10, 3)
    screen.feed(b"a\r\n0123456789")
    assert screen.cursor == (1, 9)


def test_screen_knows_the_mode_of_cursor_keys() -> None:
    """A program that asks for application cursor keys gets them."""
    screen = Screen()
    screen.feed(b"\x1b[?1h")
    assert screen.application_keys
    screen.feed(b"\x1b[?1l")
    assert not screen.application_keys


def test_screen_draws_the_end_of_a_burst() -> None:
    """Of megabytes the end is drawn, with the modes that were set in what was skipped."""
    screen = Screen(20, 3)
    screen.feed(b"shell")
    assert screen.text() == "shell"
    screen.feed(b"\x1b[?1049h\x1b[?1h")
    for _ in range(100):
        screen.feed(b"y\r\n" * 20_000)
    screen.feed(b"end")
    assert screen.text() == "y\ny\nend"
    assert screen.application_keys
    screen.feed(b"\x1b[?1049l")
    assert screen.text() == "shell"


def test_screen_heaps_up_few_marks() -> None:
    """A character under a hundred thousand accents takes no more than its place."""
    screen = Screen(20, 3)
    screen.feed(("a" + "\u0301" * 100_000).encode())
    assert len(screen.text()) <= 4


CONTROLS = [
    *(b"\x1b[", b"\x1b]", b"\x1b", b"\x1bP", b"\x1b(0", b"?", b"1049h", b"1049l", b">", b"!", b"$", b";", b"9"),
    *(b"m", b"H", b"J", b"L", b"r", b"@", b"\r", b"\n", b"x", b"\xff", b"\xe6\xbc", b"\x07", b"\\", b"\x18"),
]


@given(st.lists(st.lists(st.sampled_from(CONTROLS)).map(b"".join) | st.binary(max_size=20), max_size=10))
def test_screen_takes_anything(pieces: list[bytes]) -> None:
    """Whatever comes, the screen keeps its size, and shows something."""
    screen = Screen(20, 5)
    for piece in pieces:
        screen.feed(piece)
        lines = screen.text().split("\n")
        assert len(lines) <= 5
        assert all(len(line) <= 80 for line in lines)
        assert 0 <= screen.cursor[0] < 5
        assert 0 <= screen.cursor[1] < 20
