"""Write many lines: paged in a terminal."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable

import click

from gem_core.cli import output_width, wrapped


def write_lines(lines: Iterable[str]) -> None:
    """Write lines: paged in a terminal, else plain and as they come."""
    if not sys.stdout.isatty():
        # click.echo would flush each line, at the cost of a system call.
        sys.stdout.writelines(f"{click.unstyle(line)}\n" for line in lines)
        return
    # Wrapped between words, which a terminal breaks.
    width = output_width()
    lines = (piece for line in lines for piece in wrapped(line, width))
    # F: what fits the screen stays there without a pager. R: colours, and no other codes. X: no clearing.
    os.environ.setdefault("LESS", "-FRX")
    colours = not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    click.echo_via_pager((f"{line}\n" for line in lines), color=colours)
