"""A person at a terminal, or lines from a pipe: what is shown to them, and how their answers are read."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import click

from gem_core.errors import ArgumentError, NotSupportedError
from gem_core.suggestions import did_you_mean
from gem_core.types import Observation

BLOCK = '"""'

_MOST_COLUMNS = 100
# Control characters, on which a terminal acts instead of showing them. Colours (SGR) pass where an environment draws.
_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_CONTROLS_BUT_COLOURS = re.compile(r"\x1b(?!\[[\d;]*m)|[\x00-\x08\x0b-\x1a\x1c-\x1f\x7f-\x9f]")


class EndOfInput(Exception):
    """There is nothing more to read: Ctrl-D, or the end of a pipe."""


class Typed(NamedTuple):
    """A typed answer.

    Args:
        text: The answer, or the name of a command.
        is_command: Whether it is a command.
    """

    text: str
    is_command: bool = False


class Terminal:
    """Shows text and reads answers, with colours and a prompt only in a terminal.

    Args:
        err: Show on standard error, where standard output is for something else.
    """

    def __init__(self, *, err: bool = False) -> None:
        self._err = err
        self.interactive = sys.stdin.isatty()
        """Whether a person types, who can be asked."""
        self.drawn = (sys.stderr if err else sys.stdout).isatty()
        """Whether what is shown goes to a terminal."""
        self.colours = self.drawn and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
        self._edited = self.interactive and sys.stdout.isatty()
        for stream, errors in ((sys.stdin, "replace"), (sys.stderr if err else sys.stdout, "backslashreplace")):
            if hasattr(stream, "reconfigure"):
                stream.reconfigure(errors=errors)  # bytes that are no text are shown, and do not raise

    def _wrapped(self, text: str) -> str:
        """Return text with long lines broken between words, in a terminal; indented lines stay."""
        if not self.drawn:
            return text
        width = min(shutil.get_terminal_size((_MOST_COLUMNS, 24)).columns, _MOST_COLUMNS)
        lines = []
        for line in text.split("\n"):
            fits = len(line) <= width or line[:1].isspace()
            lines += [line] if fits else textwrap.wrap(line, width, break_on_hyphens=False)
        return "\n".join(lines)

    def _echo(self, text: str, **style: Any) -> None:
        click.echo(click.style(text, **style) if style else text, err=self._err, color=self.colours)

    def show(self, text: str = "", **style: Any) -> None:
        """Write text of our own and a line break; in a terminal, long lines are broken between words."""
        self._echo(self._wrapped(text), **style)

    def show_plainly(self, text: str) -> None:
        """Write text of an environment with control characters made visible; long lines are broken between words."""
        self._echo(self._wrapped(printable(text)))

    def show_drawing(self, text: str) -> None:
        """Write an environment's drawing, in colours if the terminal shows colours."""
        self._echo(_CONTROLS_BUT_COLOURS.sub(_visible, text))

    def show_exactly(self, text: str) -> None:
        """Write text to the letter, and a line break if it has none at its end.

        On a terminal, control characters are made visible, since it would act on them.
        """
        if self.drawn:
            text = printable(text)
        click.echo(text, nl=not text.endswith("\n"), err=self._err, color=True)

    def ask(self, prompt: str) -> Typed:
        r'''Return the next answer or command.

        ``"""`` begins a block of lines, in which nothing is a command. A lone ``?`` and what begins with ``!`` are
        commands; ``!!`` begins an answer with ``!``.

        Raises:
            EndOfInput: There is nothing more.
        '''
        while True:
            line = self.line(prompt)
            words = line.strip()
            if line.startswith(BLOCK):
                return Typed(self._block(line.removeprefix(BLOCK)))
            if words == "?":
                return Typed("help", True)
            if words.startswith("!") and not words.startswith("!!"):
                return Typed(words[1:].strip(), True)
            if words:
                return Typed(words[1:] if words.startswith("!!") else line.rstrip())
            if self.interactive:
                self.show(f"Type an answer, or ? for help. {BLOCK * 2} is the empty answer.", dim=True)

    def ask_for_answer(self, prompt: str, answer_of: Callable[[Typed], str | None]) -> str:
        """Ask until what was typed gives an answer.

        Args:
            prompt: Text before the answer.
            answer_of: Returns the answer, or None for a command that gives none; what is wrong with it is shown.

        Raises:
            EndOfInput: There is nothing more.
        """
        while True:
            typed = self.ask(prompt)
            try:
                answer = answer_of(typed)
            except (ArgumentError, NotSupportedError) as error:
                self.show(f"{error}.", fg="yellow")
                continue
            if answer is not None:
                return answer

    def line(self, prompt: str) -> str:
        """Return the next line that is typed.

        Raises:
            EndOfInput: There is nothing more.
        """
        if self._edited:
            with contextlib.suppress(ImportError):
                import readline  # noqa: F401 - gives input() keys to edit a line, and earlier lines
            try:
                return input(self._coloured(prompt))
            except EOFError:
                click.echo()
                raise EndOfInput from None
            except KeyboardInterrupt:
                click.echo()  # so that what follows does not stand behind the prompt
                raise
        if self.interactive:
            click.echo(prompt, nl=False, err=True)
        line = sys.stdin.readline()
        if not line:
            raise EndOfInput
        return line.removesuffix("\n")

    def _coloured(self, prompt: str) -> str:
        # \001 and \002 tell readline that what stands between them takes no room.
        return f"\001\x1b[1;36m\002{prompt}\001\x1b[0m\002" if self.colours else prompt

    def _block(self, first: str) -> str:
        if first.rstrip().endswith(BLOCK):
            return first.rstrip().removesuffix(BLOCK)
        lines = [first] if first.strip() else []
        # Opened by a line of its own, it is closed by a line of its own: code may have a docstring.
        alone = not lines
        while True:
            line = self.line("... ")
            if line.rstrip() == BLOCK:
                return "\n".join(lines)
            if not alone and line.rstrip().endswith(BLOCK):
                return "\n".join([*lines, line.rstrip().removesuffix(BLOCK)])
            lines.append(line)


def _visible(match: re.Match[str]) -> str:
    return "".join(f"\\x{ord(character):02x}" for character in match[0])


def resolve_abbreviation(typed: str, commands: Sequence[str]) -> str:
    """Return the command that was typed, or cut short.

    Raises:
        ArgumentError: There is none, or several begin so.
    """
    found = [name for name in commands if name.startswith(typed.casefold())] if typed else []
    if len(found) == 1:
        return found[0]
    listed = ", ".join(f"!{name}" for name in found or commands)
    raise ArgumentError(f"no command '!{typed}'.{did_you_mean(typed, commands)} There are: {listed}, and ?")


def printable(text: str) -> str:
    """Return text with control characters made visible, but for tabs and line breaks."""
    return _CONTROLS.sub(_visible, text)


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
