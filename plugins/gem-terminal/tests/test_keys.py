"""Keys as agents write them, and the bytes of a terminal."""

from __future__ import annotations

import pytest

from gem_terminal.shell.keys import key_bytes


@pytest.mark.parametrize(
    ("keys", "sent"),
    [
        ("ls -l<Enter>", b"ls -l\r"),
        ("a\nb\r\n", b"a\rb\r"),
        ("<C-c><C-d><C-z><C-[><C-Space>", b"\x03\x04\x1a\x1b\x00"),
        ("<Esc>:wq<CR>", b"\x1b:wq\r"),
        ("<Up><Down><Right><Left>", b"\x1b[A\x1b[B\x1b[C\x1b[D"),
        ("<Home><End><PageUp><PageDown><Del><Insert>", b"\x1b[H\x1b[F\x1b[5~\x1b[6~\x1b[3~\x1b[2~"),
        ("<S-Up><C-Right><C-S-F5><A-Left>", b"\x1b[1;2A\x1b[1;5C\x1b[15;6~\x1b[1;3D"),
        ("<A-x><M-X><C-A-c>", b"\x1bx\x1bX\x1b\x03"),
        ("<BS><Tab><S-Tab><Space><lt>Enter>", b"\x7f\t\x1b[Z <Enter>"),
        ("C-c", b"\x03"),
        ("M-x", b"\x1bx"),
        ("<div>a</div><C-é><Enter <>", b"<div>a</div><C-\xc3\xa9><Enter <>"),
        ("x <C-c> C-c", b"x \x03 C-c"),
        ("é\ud800", b"\xc3\xa9?"),
        ("", b""),
    ],
)
def test_key_bytes_sends_what_a_terminal_would(keys: str, sent: bytes) -> None:
    """Text is typed as it is, special keys are sent, and what is no key stays literal."""
    assert key_bytes(keys) == sent


def test_key_bytes_follows_the_mode_of_the_program() -> None:
    """Cursor keys change with the mode that a program asks for, unless they are held with others."""
    assert key_bytes("<Up><Home><S-Up>", application=True) == b"\x1bOA\x1bOH\x1b[1;2A"
