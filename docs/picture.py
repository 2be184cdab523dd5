"""Draw what a command shows in a terminal as an SVG, for the README.

    python docs/picture.py docs/images/gem-run.svg gem run game:GuessTheNumber-v0 --agent bisect

The command runs in a real pseudo-terminal; the picture is its last screen. Needs pyte, a terminal emulator in Python.
"""

from __future__ import annotations

import fcntl
import io
import os
import pty
import select
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pyte
from rich.console import Console
from rich.style import Style
from rich.text import Text

COLUMNS, LINES = 130, 40

# rich's own frame, without the fonts that it would load from the network.
FRAME = """<svg class="rich-terminal" viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font-family: Menlo, Consolas, "DejaVu Sans Mono", monospace; font-size: {char_height}px;
  line-height: {line_height}px; font-variant-east-asian: full-width; }}
.{unique_id}-title {{ font-size: 18px; font-weight: bold; font-family: arial; }}
{styles}
</style>
<defs>
<clipPath id="{unique_id}-clip-terminal">
<rect x="0" y="0" width="{terminal_width}" height="{terminal_height}" />
</clipPath>
{lines}
</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g>
</g>
</svg>
"""


def last_screen(command: list[str]) -> pyte.Screen:
    """Run a command in a terminal and return what its screen shows at the end."""
    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", LINES, COLUMNS, 0, 0))
    screen = pyte.Screen(COLUMNS, LINES)
    stream = pyte.ByteStream(screen)
    # pyte ends lines only at a carriage return with a line feed, as the terminal's driver sends them.
    env = {**os.environ, "TERM": "xterm-256color", "COLUMNS": str(COLUMNS)}
    with subprocess.Popen(command, stdin=follower, stdout=follower, stderr=follower, env=env):
        os.close(follower)
        while select.select([leader], [], [], 60)[0]:
            try:
                stream.feed(os.read(leader, 65536))
            except OSError:  # the command is over
                break
    return screen


def drawn(screen: pyte.Screen) -> Text:
    """Return a screen as rich text."""
    lines = []
    for row in range(LINES):
        line = Text()
        for column in range(COLUMNS):
            cell = screen.buffer[row][column]
            color = None if cell.fg == "default" else cell.fg
            style = Style(color=f"#{color}" if color and len(color) == 6 else color, bold=cell.bold)
            line.append(cell.data, style=style)
        line.rstrip()
        lines.append(line)
    while lines and not lines[-1].plain:
        lines.pop()
    return Text("\n").join(lines)


def main() -> None:
    """Draw the command of the command line."""
    target, *command = sys.argv[1:]
    screen = last_screen(command)
    console = Console(record=True, width=COLUMNS, file=io.StringIO(), force_terminal=True)
    console.print(Text("$ ", style="green") + Text(" ".join(command)))
    console.print(drawn(screen))
    Path(target).write_text(console.export_svg(title="gem", code_format=FRAME, unique_id="gem"), encoding="utf-8")


if __name__ == "__main__":
    main()
