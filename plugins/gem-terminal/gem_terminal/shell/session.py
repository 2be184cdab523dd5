"""One shell in one terminal: what is typed into it, and what comes out of it in order."""

from __future__ import annotations

import os.path
import secrets
import time
from collections import deque
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from gem_terminal.errors import MachineLostError
from gem_terminal.shell.script import START, Mark, Marks, ask_line, keys_line, run_line, set_up_line

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Machine, Terminal
    from gem_terminal.shell.output import Output

READY_S = 2.0
"""Seconds that an idle shell may take to get ready."""

_OPEN_S = 20.0
_PIECE = 16_384
_SHELLS = ("bash", "sh", "dash", "ash")


class ShellEndedError(Exception):
    """The shell is gone, though its machine may be there.

    Args:
        status: Its exit code; None where it is unknown.
    """

    def __init__(self, status: int | None) -> None:
        super().__init__(status)
        self.status = status


class Session:
    """A shell that runs in a terminal, and what is known of it.

    Args:
        machine: Where it runs.
        terminal: Where it runs in; ``open_session`` makes both.
        word: What the marks of its beginning and its end bear.
    """

    def __init__(self, machine: Machine, terminal: Terminal, word: str) -> None:
        self.machine, self.terminal = machine, terminal
        self.pid = self.leader = 0
        """Number of the shell, and of the process that started it, which is the first of the terminal."""

        self.workdir = ""
        self.by_keys = False
        self.at_prompt = True
        self.beginning: Mark | None = None
        """The mark of the last command's beginning."""

        self._word, self._prompt = word, _new_word()
        self._bash = self._echoes = self._begun = False
        self._marks = Marks()
        self._status: int | None = None
        self._unread: deque[bytes | Mark] = deque()

    def type(self, data: bytes) -> None:
        """Type; see ``Terminal.write``.

        Raises:
            ShellEndedError: The shell is gone.
            MachineLostError: The machine is.
        """
        try:
            self.terminal.write(data)
        except MachineLostError as error:
            raise self._ended() from error

    def events(self, timeout_s: float) -> Iterator[bytes | Mark]:
        """Yield what came next, as soon as there is something; nothing when ``timeout_s`` has passed.

        Raises:
            ShellEndedError, MachineLostError: As ``type`` has them; all that was written was yielded before.
        """
        if not self._unread:
            try:
                self._unread += self._marks.feed(self.terminal.read(timeout_s))
            except MachineLostError as error:
                rest = self._marks.rest()
                if not rest:
                    raise self._ended() from error
                self._unread.append(rest)
        while self._unread:
            event = self._unread.popleft()
            if isinstance(event, Mark):
                self._learn(event)
            yield event

    def run(self, command: str, timeout_s: float, output: Output) -> Mark | None:
        """Run a command; return how the shell is when it has ended, None when its time is over first."""
        begin, end = _new_word(), _new_word()
        deadline = time.monotonic() + timeout_s
        self.beginning = None
        # What changes the terminal mostly says so; what does not is found out by its echo of the next command.
        tidy = self._echoes or "stty" in command
        typed = run_line(command, begin, end, bash=self._bash, tidy=tidy)
        self._echoes = self._begun = False
        # A shell that another has replaced says nothing; it is looked for where that can be.
        looks = [0.5, 2.0] if "exec" in command else []
        while typed or (left := deadline - time.monotonic()) > 0:
            # What the terminal echoes is taken while it is typed, or it would hold us up.
            if typed:
                self.type(typed[:_PIECE])
                typed, left = typed[_PIECE:], 0.0
            silent = True
            for event in self.events(min([left, *looks[:1]])):
                silent = False
                if isinstance(event, bytes):
                    output.feed(event)
                elif self._has_ended(event, begin, end, output):
                    if event.word != end:
                        self.set_up(READY_S)  # another shell may be in the place of ours, without our functions
                    return event
            if silent and left and looks:
                del looks[0]
                if self.takes_over() and self.set_up(READY_S):
                    return Mark("P", end)
        return None

    def _has_ended(self, mark: Mark, begin: str, end: str, output: Output) -> bool:
        """Note the beginning of a command; tell whether it has ended, by itself or broken off."""
        if mark.kind == "B" and mark.word == begin:
            self._begun, self.beginning = True, mark
            if output.has(b"__gem_begin"):
                output.clear()  # the terminal has shown what was typed
                self._echoes = True
        return mark.kind == "P" and (mark.word == end or (self._begun and mark.word == self._prompt))

    def wait_for(self, word: str, timeout_s: float) -> bool:
        """Pass over what is written until a mark bears a word; tell whether it came."""
        end = time.monotonic() + timeout_s
        while (left := end - time.monotonic()) > 0:
            for event in self.events(left):
                if isinstance(event, Mark) and event.word == word and event.kind in "PS":
                    return True
        return False

    def set_up(self, timeout_s: float) -> bool:
        """Make the shell ready for commands, in whatever state it is; tell whether it is."""
        word = _new_word()
        self.type(set_up_line(self._prompt, word))
        self.by_keys = False
        return self.wait_for(word, timeout_s)

    def is_ready(self, timeout_s: float) -> bool:
        """Tell whether a shell that was set up takes commands."""
        word = _new_word()
        self.type(ask_line(word))
        return self.wait_for(word, timeout_s)

    def give_to_keys(self) -> bool:
        """Have the shell show a prompt, and what is typed; tell whether it does."""
        word = _new_word()
        self.type(keys_line(word))
        self.by_keys = self.at_prompt = self.wait_for(word, READY_S)
        return self.by_keys

    def takes_over(self) -> bool:
        """Tell whether another shell has taken the place of ours (``exec bash``), and waits."""
        processes = self.machine.processes()
        words = next((process.command for process in processes if process.pid == self.pid), "").split()
        is_shell = bool(words) and os.path.basename(words[0]).lstrip("-") in _SHELLS
        return is_shell and "--noediting" not in words and all(process.parent != self.pid for process in processes)

    def interrupt(self) -> None:
        """Break off the line that stands at a prompt."""
        self.type(b"\x03")
        self.wait_for(self._prompt, 0.3)

    def _learn(self, mark: Mark) -> None:
        if mark.kind == "P":
            self.pid, self.workdir, self._bash = mark.pid, mark.workdir, mark.bash
        elif mark.kind == "S":
            self.leader = mark.pid
        elif mark.kind == "X" and mark.word == self._word:
            self._status = mark.status

    def _ended(self) -> Exception:
        return self.machine.why_lost() or ShellEndedError(self._status)


def _new_word() -> str:
    """Return a word that nobody can guess."""
    return secrets.token_hex(8)


def open_session(
    machine: Machine, *, user: str, workdir: str, env: Mapping[str, str], columns: int, lines: int, again: bool
) -> Session:
    """Start a shell that is ready for commands.

    What it reads at its start (``.bashrc``) may end it or hold it up, by the agent's doing; it is then started without.

    Args:
        machine: Where it runs.
        user: Who it runs as.
        workdir: Where it begins.
        env: Variables beside the container's.
        columns: Width of the terminal.
        lines: Height of the terminal.
        again: Whether a shell has run in the machine before. Then the agent's processes may have left no room for
            another, and one that does not start is the agent's doing.

    Raises:
        MachineLostError: There is no shell, or the machine is gone.
    """
    if again:
        machine.make_room()
    for plain in ("", "norc"):
        word = _new_word()
        command = ["/bin/sh", "-c", START, "terminal", word, workdir, plain]
        terminal = machine.open_terminal(command, user=user, env=env, columns=columns, lines=lines)
        session = Session(machine, terminal, word)
        try:
            if session.wait_for(word, _OPEN_S) and session.set_up(_OPEN_S / 2):
                return session
        except ShellEndedError:
            pass
        except BaseException:
            terminal.close()
            raise
        terminal.close()
    raise MachineLostError(
        f"no shell starts in {machine.id}: /bin/sh and bash (or sh) must be there, and run",
        by_agent=True if again else None,
    )
