"""One shell in one terminal: what is typed into it, and what comes out of it in order."""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from gem_terminal.errors import MachineLostError
from gem_terminal.shell_script import BASH, SH, START, Dialect, Mark, Marks

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Machine, Terminal

_OPEN_S = 20.0
_PIECE = 32_768
_END_S = 5.0


class ShellEndedError(Exception):
    """The shell is gone, though its machine may be there.

    Args:
        status: Its exit code; None where it is unknown.
    """

    def __init__(self, status: int | None) -> None:
        super().__init__(status)
        self.status = status


def new_word() -> str:
    """Return a word that nobody can guess."""
    return secrets.token_hex(8)


class Session:
    """A shell that runs in a terminal, and what is known of it.

    Args:
        machine: Where it runs.
        terminal: Where it runs in; ``open_session`` makes both.
        word: What the mark of its end bears.
    """

    def __init__(self, machine: Machine, terminal: Terminal, word: str) -> None:
        self.machine = machine
        self.terminal = terminal
        self.dialect: Dialect = BASH
        self.pid = 0
        self.workdir = ""
        self.quiet = True
        self.echoes = False
        """Whether the terminal was seen to show what is typed, though it was told not to."""

        self.opened_s: float | None = None
        self.keys_word: str | None = None
        """The word of the marks while an agent types itself; None while commands are run."""

        self.at_prompt = True
        self._word = word
        self._marks = Marks()
        self._status: int | None = None
        self._ended_by: float | None = None
        self._unread: deque[bytes | Mark] = deque()

    @property
    def leader(self) -> int:
        """Number of the process that started the shell, and is the first of its terminal."""
        return self.terminal.pid

    def type(self, data: bytes) -> None:
        """Type; see ``Terminal.write``.

        Raises:
            ShellEndedError: The shell is gone.
            MachineLostError: The machine is.
        """
        for start in range(0, len(data), _PIECE):
            try:
                self.terminal.write(data[start : start + _PIECE])
            except MachineLostError as error:
                raise self._ended() from error

    def events(self, timeout_s: float) -> Iterator[bytes | Mark]:
        """Yield what came next, as soon as there is something; nothing when ``timeout_s`` has passed.

        Raises:
            ShellEndedError, MachineLostError: As ``type`` has them; all that was written was yielded before.
        """
        if not self._unread:
            self._read(timeout_s)
        while self._unread:
            yield self._unread.popleft()

    def _read(self, timeout_s: float) -> None:
        if self._ended_by is not None:
            timeout_s = min(timeout_s, max(0.0, self._ended_by - time.monotonic()))
        try:
            data = self.terminal.read(timeout_s)
        except MachineLostError as error:
            rest = self._marks.rest()
            if rest:
                self._unread.append(rest)
                return
            raise self._ended() from error
        for event in self._marks.feed(data) if data else ():
            if isinstance(event, Mark) and event.kind == "X":
                if event.word == self._word:
                    # Believed when the terminal ends with it, since anyone can read its word.
                    self._status, self._ended_by = event.status, time.monotonic() + _END_S
                continue
            if isinstance(event, Mark) and event.kind == "P":
                self._learn(event)
            self._unread.append(event)
        if not data and self._ended_by is not None and time.monotonic() >= self._ended_by:
            self._ended_by = None
            if not any(process.pid == self.pid for process in self.machine.processes()):
                raise self._ended()
            self._status = None

    def wait_for(self, word: str, timeout_s: float) -> tuple[Mark | None, bytes]:
        """Return the mark of readiness with a word, and what was written before; None when it did not come."""
        written, end = bytearray(), time.monotonic() + timeout_s
        while (left := end - time.monotonic()) > 0:
            for event in self.events(left):
                if isinstance(event, bytes):
                    written += event[-_PIECE:]
                    del written[:-_PIECE]
                elif event.kind in "PS" and event.word == word:
                    return event, bytes(written)
        return None, bytes(written)

    def set_up(self, timeout_s: float) -> bool:
        """Make the shell ready for commands, in whatever state it is; tell whether it is."""
        word = new_word()
        self.type(self.dialect.set_up(word))
        ready, _ = self.wait_for(word, timeout_s)
        self.keys_word = None
        return ready is not None

    def close(self) -> None:
        """Let go of it."""
        self.terminal.close()

    def _learn(self, mark: Mark) -> None:
        self.pid = mark.pid
        self.workdir = mark.workdir
        self.quiet = mark.quiet

    def _ended(self) -> ShellEndedError:
        why = self.machine.why_lost()
        if why is not None:
            raise why
        return ShellEndedError(self._status)


def open_session(
    machine: Machine,
    *,
    user: str = "",
    workdir: str = "",
    env: Mapping[str, str] | None = None,
    columns: int = 120,
    lines: int = 40,
) -> Session:
    """Start a shell that is ready for commands.

    What it reads at its start (``.bashrc``) may end it or hold it up, by the agent's doing; it is then started without.

    Raises:
        MachineLostError: There is no shell, or the machine is gone.
    """
    for plain in ("", "norc"):
        word = new_word()
        command = ["/bin/sh", "-c", START, "terminal", word, workdir, plain]
        terminal = machine.open_terminal(command, user=user, env=env, columns=columns, lines=lines)
        session = Session(machine, terminal, word)
        try:
            started, _ = session.wait_for(word, _OPEN_S)
            if started is not None:
                session.opened_s = started.uptime_s
                session.dialect = BASH if started.background else SH
                if session.set_up(_OPEN_S / 2):
                    return session
        except ShellEndedError:
            pass
        except BaseException:
            terminal.close()
            raise
        terminal.close()
    raise MachineLostError(
        f"no shell starts in {machine.id}: /bin/sh and bash (or sh) must be there, and run", by_agent=None
    )
