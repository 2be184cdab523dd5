"""A person at a terminal, or lines from a pipe: what is shown to them, and how their answers are read."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Mapping
from typing import Any

from gem_core.errors import ArgumentError, NotSupportedError
from gem_core.suggestions import did_you_mean
from gem_core.types import Observation

BLOCK = '"""'
"""The line before and after an answer of several lines."""

_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Control characters, on which a terminal acts instead of showing them."""


class Terminal:
    """Shows text and reads answers, with colours and a prompt only in a terminal.

    Args:
        err: Show on standard error, where standard output is for something else.
    """

    def __init__(self, *, err: bool = False) -> None:
        from rich.console import Console  # not before something is shown

        self.console = Console(stderr=err, highlight=False)
        self.interactive = sys.stdin.isatty()
        """Whether a person types, who can be asked."""
        for stream, errors in ((sys.stdin, "replace"), (sys.stderr if err else sys.stdout, "backslashreplace")):
            if hasattr(stream, "reconfigure"):
                stream.reconfigure(errors=errors)  # bytes that are no text are shown, and do not raise

    def show(self, text: str = "", style: str = "") -> None:
        """Write text with control characters made visible; in a terminal, long lines are broken between words."""
        from rich.text import Text

        self.console.print(Text(printable(text)), style=style, soft_wrap=not self.console.is_terminal)

    def show_drawing(self, text: str) -> None:
        """Write an environment's drawing, in colours if the terminal shows colours."""
        from rich.text import Text

        # Of what begins with an escape character, rich keeps colours alone.
        drawn = "\x1b".join(map(printable, text.split("\x1b")))
        self.console.print(Text.from_ansi(drawn), soft_wrap=True)

    def show_exactly(self, text: str) -> None:
        """Write text to the letter, in a terminal with control characters made visible; a line break ends it."""
        text = printable(text) if self.console.is_terminal else text
        self.console.file.write(text if text.endswith("\n") else f"{text}\n")

    def line(self, prompt: str) -> str:
        """Return the next line that is typed.

        Raises:
            EOFError: There is nothing more: Ctrl-D, or the end of a pipe.
        """
        if not self.interactive:
            return input()
        import readline  # noqa: F401 - gives input() keys to edit a line, and earlier lines

        if not sys.stdout.isatty():
            sys.stderr.write(prompt)  # standard output is for something else
        try:
            return input(prompt if sys.stdout.isatty() else "")
        except (EOFError, KeyboardInterrupt):
            self.console.print()  # what follows begins on a line of its own
            raise

    def ask(self, prompt: str, commands: Mapping[str, Callable[[], str | None]]) -> str:
        r'''Return the next answer: a line, the lines between two lines of ``"""``, or what a command gives.

        Args:
            prompt: Text before the answer.
            commands: Called for a line such as ``!random``, by name, and ``help`` for ``?`` as well. One that returns
                None gives no answer; an ``ArgumentError`` or ``NotSupportedError`` that it raises is shown.
                ``!quit`` ends the input.

        Raises:
            EOFError: There is nothing more.
        '''
        while True:
            line = self.line(prompt).rstrip()
            if line == BLOCK:
                return "\n".join(iter(lambda: self.line("... "), BLOCK))
            if line != "?" and not line.startswith("!"):
                if line:
                    return line
                continue
            name = "help" if line == "?" else line[1:]
            if name == "quit":
                raise EOFError
            try:
                if name not in commands:
                    listed = ", ".join(f"!{each}" for each in (*commands, "quit"))
                    raise ArgumentError(f"no command '!{name}'.{did_you_mean(name, commands)} There are: {listed}")
                answer = commands[name]()
            except (ArgumentError, NotSupportedError) as error:
                self.show(f"{error}.", "yellow")
                continue
            if answer is not None:
                return answer


def printable(text: str) -> str:
    """Return text with control characters made visible, but for tabs and line breaks."""
    return _CONTROLS.sub(lambda match: f"\\x{ord(match[0]):02x}", text)


def observation_text(observation: Observation, save_image: Callable[[Any], object] | None = None) -> str:
    """Return an observation as text: what it holds to the letter, and a line for each image and each message's role.

    Args:
        observation: Text, content parts, or messages.
        save_image: Writes an image to a file, so that a person can open it, and returns the path; None only tells the
            image's size.
    """
    if isinstance(observation, str):
        return observation
    return "\n".join(_part_text(part, save_image) for part in observation)


def _part_text(part: Mapping[str, Any], save_image: Callable[[Any], object] | None) -> str:
    if "role" in part:
        calls = f"\n{json.dumps(part['tool_calls'], default=repr)}" if part.get("tool_calls") else ""
        return f"[{part['role']}]\n{observation_text(part.get('content') or '', save_image)}{calls}"
    if part.get("type") == "text":
        return str(part.get("text", ""))
    image: Any = part.get("image")
    if hasattr(image, "size") and hasattr(image, "tobytes"):
        place = "" if save_image is None else f" {save_image(image)}"
        return f"[image {image.size[0]}x{image.size[1]}{place}]"
    return json.dumps(part, default=repr)
