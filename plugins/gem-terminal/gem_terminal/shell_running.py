"""A command that was typed into a shell, until the shell is ready again."""

from __future__ import annotations

import os.path
import time

from gem_terminal.shell_output import Output
from gem_terminal.shell_processes import Beginning
from gem_terminal.shell_script import BASH, SH, Mark
from gem_terminal.shell_session import Session, new_word

READY_S = 2.0
"""Seconds that an idle shell may take to get ready."""

_MOST_ASKED = 20
"""Times that a shell is asked whether it is ready; a program that says so again and again is not listened to."""

_SHELLS = {"bash": BASH, "sh": SH, "dash": SH, "ash": SH}


class Running:
    """A command that was typed, until the shell is ready again."""

    def __init__(self, session: Session, command: str, timeout_s: float, output: Output) -> None:
        self.beginning: Beginning | None = None
        self._session = session
        self._output = output
        self._begin, self._word = new_word(), new_word()
        self._end = time.monotonic() + timeout_s
        self._again: set[str] = set()
        # A shell that is replaced by another says nothing; it is looked for where that can be.
        self._looks = [0.5, 2.0] if "exec" in command else []
        self._begun = self._typed_again = False
        # What changes the terminal mostly says so; what does not is found out by its echo of the next command.
        self._typed = session.dialect.command(
            command, self._begin, self._word, tidy=session.echoes or "stty" in command
        )
        session.echoes = False

    def result(self) -> Mark | None:
        """Return how the shell is when the command has ended; None when its time is over first."""
        ready = self._type()
        if ready is not None:
            return ready
        while (left := self._end - time.monotonic()) > 0:
            ready = self._hear(min([left, *self._looks[:1]]))
            if ready is not None:
                return ready
            if self._looks and self._silent:
                del self._looks[0]
                if takes_over(self._session) and self._session.set_up(READY_S):
                    return Mark("P", self._word)
        return None

    def _type(self) -> Mark | None:
        # What the terminal echoes, where it cannot be told not to, is taken meanwhile, or it would hold us up.
        for start in range(0, len(self._typed), 16_384):
            self._session.type(self._typed[start : start + 16_384])
            if start and (ready := self._hear(0.0)) is not None:
                return ready
        return None

    def is_ready(self, timeout_s: float) -> bool:
        """Tell whether the shell gets ready, its command broken off; what is still written is left out."""
        self._output = Output(0)
        end = time.monotonic() + timeout_s
        while (left := end - time.monotonic()) > 0:
            if self._hear(left) is not None:
                return True
        return False

    def _hear(self, timeout_s: float) -> Mark | None:
        self._silent = True
        for event in self._session.events(timeout_s):
            self._silent = False
            if isinstance(event, bytes):
                self._output.feed(event)
            elif event.kind == "B" and event.word == self._begin:
                self._begun = True
                if event.uptime_s is not None:
                    self.beginning = Beginning(event.uptime_s, event.background)
                if not self._session.quiet or self._output.has(b"__gem_begin"):
                    self._output.clear()  # the terminal has shown what was typed
                    self._session.echoes = True
            elif event.kind == "P" and (event.word == self._word or event.word in self._again):
                return event
            elif event.kind == "P" and not event.word and not self._begun:
                if self._typed_again or not self._session.dialect.restless:
                    continue  # from before
                # After an unbalanced quote in eval, bash 5.2 refuses the braces that the next line begins with.
                self._typed_again = True
                self._output.clear()
                return self._type()
            elif event.kind == "P" and not event.word and len(self._again) < _MOST_ASKED:
                # The command was broken off, as by an error of an expansion. A program could say so too: the shell
                # is asked for a word that only it knows, and a program would be given that as its input.
                word = new_word()
                self._again.add(word)
                self._session.type(self._session.dialect.again(word))
        return None


def takes_over(session: Session) -> bool:
    """Tell whether another shell has taken the place of ours (``exec bash``), and waits; it can be set up as well."""
    processes = session.machine.processes()
    if any(process.parent == session.pid for process in processes):
        return False
    words = next((process.command for process in processes if process.pid == session.pid), "").split()
    dialect = _SHELLS.get(os.path.basename(words[0]).lstrip("-")) if words else None
    if dialect is None or (len(words) > 1 and words[-1] == "-i" and "--noediting" in words):
        return False
    session.dialect = dialect
    return True
