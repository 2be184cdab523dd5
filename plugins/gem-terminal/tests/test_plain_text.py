"""Output as a person would read it, and hostile output."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_terminal.shell.output import Output
from gem_terminal.shell.screen import plain_text


@pytest.mark.parametrize(
    ("output", "text"),
    [
        ("a\r\nb\r\n", "a\nb\n"),
        (" 10%\r 50%\r100%\n", "100%\n"),
        ("long line\rshort\n", "shortline\n"),
        ("long line\r\x1b[Kshort\n", "short\n"),
        ("abc\b\bX\n", "aXc\n"),
        ("N\bNA\bAM\bME\bE\n", "NAME\n"),
        ("\x1b[1;31mred\x1b[0m \x1b[38;5;9mx\x1b[m\n", "red x\n"),
        ("\x1b]0;title\x07a\x1b]8;;http://x\x1b\\link\x1b]8;;\x1b\\\n", "alink\n"),
        ("\x1b]0;never ended\nnext\n", "\nnext\n"),
        ("\x1bPq#0data\x1b\\x\x1b(B\x1b=\x1b>\x1b[?25l\x1b[4 q\x1b[>4;2m\n", "x\n"),
        ("one\ntwo\n\x1b[1A\x1b[2Kdone\n", "one\ndone\n"),
        ("before\n\x1b[H\x1b[2Jafter\n", "before\nafter\n"),
        ("\x1b[H\x1b[2Jtop 1\n\x1b[Htop 2\n", "top 2\n"),
        ("a\x1b[?1049hdrawn\x1b[2J\x1b[?1049lb", "ab"),
        ("a\x1b[?1049hstill there", "a\n still there"),
        ("bell\x07 nul\x00 del\x7f c1\x9b\n", "bell nul del c1\n"),
        ("\x1b[1m" + "long " * 100 + "\x1b[m\n", "long " * 100 + "\n"),
        ("\r" + "漢字\u200b e\u0301👩\u200d💻 " * 50, "漢字 é👩💻 " * 49 + "漢字 é👩💻"),
        ("".join(f"\r\x1b[K{n} done\n" for n in range(100)), "".join(f"{n} done\n" for n in range(100))),
        ("x\x1b", "x"),
        ("\x1b[999999999999999999C!", " " * 119 + "!"),
    ],
)
def test_plain_text_resolves_what_steers(output: str, text: str) -> None:
    """What was overwritten, erased or meant for the terminal is not shown."""
    assert plain_text(output) == text


CONTROLS = [
    *("\x1b[", "\x1b]", "\x1b", "A", "H", "2J", "K", ";", "9999", "m"),
    *("?1049h", "?1049l", "\r", "\b", "\n", "\t", "x", "é", "\x07", "\\", "P"),
]


@given(st.lists(st.sampled_from(CONTROLS), max_size=60).map("".join))
def test_plain_text_takes_anything(output: str) -> None:
    """Whatever comes, no control character is left, and it takes no more room than a screen beside the output."""
    text = plain_text(output)
    assert not {character for character in text if character < " "} - {"\n", "\t"}
    assert len(text) <= len(output) * 600 + 40


@pytest.mark.parametrize("piece", ["a\r", "\x1b]", "\x1b[9999B", "\x1b[500C\n", "\x1b[2J", "\x1b[?1049h"])
def test_plain_text_takes_much(piece: str) -> None:
    """A lot of hostile output is read, in time that grows with its length."""
    assert len(plain_text(piece * 20_000)) < 14_000_000


def test_output_is_cut_in_the_middle() -> None:
    """Of much output the beginning and the end stay, with a note of how much is missing."""
    output = Output(100)
    for number in range(200_000):
        output.feed("%06dé\n".encode() % number)
    text, dropped = output.text()
    assert text.startswith("000000é\n000001é\n")
    assert text.endswith("199999é\n")
    assert f"\n[… {dropped} characters left out …]\n" in text
    assert dropped > 1_599_000
    output = Output(50)
    output.feed("aé".encode() * 200_000)
    assert "\ufffd" not in output.text()[0]


def test_output_that_fits_is_whole() -> None:
    """A progress bar of megabytes that overwrites itself is a line, and nothing of what stands is missing."""
    output = Output(1000)
    for number in range(2000):
        output.feed(b"\r%6d" % number)
    assert output.text() == ("  1999", 0)
