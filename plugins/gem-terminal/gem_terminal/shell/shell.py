"""``Shell``: a persistent shell in a pseudo-terminal of a machine, for commands and for keys.

A command is typed into a real interactive bash, so that its working directory, variables, functions, jobs and traps are
those of one shell from turn to turn. How the shell tells that it is ready is in ``script.py``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gem_terminal.errors import MachineError, MachineLostError
from gem_terminal.shell.keys import key_bytes
from gem_terminal.shell.output import Output
from gem_terminal.shell.results import CommandResult, ScreenResult
from gem_terminal.shell.screen import Screen
from gem_terminal.shell.script import Mark
from gem_terminal.shell.session import READY_S, Session, ShellEndedError, open_session

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Machine, Process

_QUIET_S = 0.25
"""A screen that has not changed for so long is at rest."""

_INTERRUPTED_S = 0.3
_KILLING_S = 10.0
_DYING_S = 1.0
_TICKS = 100
"""Clock ticks of a second in ``/proc``, on every architecture of today."""

_WAITING = (
    "A program that was started with keys holds the terminal, so the command was not run. Leave the program first, as "
    "with <keys>q</keys>, <keys><C-c></keys> or <keys><C-d></keys>; look at it with <keys></keys>."
)


class Shell:
    """A shell that stays open from turn to turn; a new one is started when it ends. Not for several threads at once.

    Args:
        machine: Where it runs; stays the caller's.
        user: Who it runs as; empty for the container's user.
        workdir: Where it begins; empty for the container's.
        columns: Width of the terminal.
        lines: Height of the terminal.
        most_output: Characters of a command's output; what is more is cut out of the middle.
        again: Whether an agent has had a shell in the machine before.
    """

    def __init__(
        self,
        machine: Machine,
        *,
        user: str = "",
        workdir: str = "",
        columns: int = 120,
        lines: int = 40,
        most_output: int = 16_000,
        again: bool = False,
    ) -> None:
        self._machine = machine
        self._again = again
        self._user = user
        self._workdir = workdir
        # Pagers would wait for a key: for commands nothing is paged.
        self._env = {"TERM": "xterm-256color", "PAGER": "cat", "GIT_PAGER": "cat", "MANPAGER": "cat"}
        self._most_output = most_output
        self._screen = Screen(columns, lines)
        self._session: Session | None = None
        self._exit_code: int | None = None
        self._ended_with: int | None = None

    @property
    def workdir(self) -> str:
        """The working directory, when the shell was last heard of."""
        return self._workdir if self._session is None else self._session.workdir

    def open(self) -> None:
        """Start the shell now, and not with the first command.

        Raises:
            MachineLostError: The machine is gone, or has no shell.
            EngineError: The engine does not answer.
        """
        self._opened()

    def close(self) -> None:
        """End it, as when a terminal is closed. May be called again; a later command starts a new one."""
        session, self._session = self._session, None
        if session is not None:
            self._workdir = session.workdir or self._workdir
            session.terminal.close()

    def run(self, command: str, timeout_s: float) -> CommandResult:
        """Run a command and wait for it to end.

        A command that reads its input gets the terminal, where nobody types: it ends with its time.

        Args:
            command: Any text; characters that no shell can read (NUL) are left out.
            timeout_s: Seconds that it may take; then all that it has started is killed, also in the background.

        Raises:
            MachineLostError: The machine is gone.
            EngineError: The engine does not answer.
        """
        output = Output(self._most_output)
        restarted = self._catch_up(output)
        session = self._opened()
        try:
            if not self._take_from_keys(session):
                return CommandResult("", None, workdir=session.workdir, waiting=True, note=_WAITING)
        except ShellEndedError:
            self.close()
            session, restarted = self._opened(), True
        try:
            ended = session.run(command, timeout_s, output)
        except ShellEndedError as error:
            return self._ended(error, output)
        if ended is None:
            return self._stopped(session, output, timeout_s)
        note = f"The shell had ended; a new one was started in {session.workdir}." if restarted else ""
        return self._result(output, ended.status, restarted=restarted, note=note)

    def press(self, keys: str, wait_s: float) -> ScreenResult:
        """Type keys, and return the screen once it has come to rest.

        At the shell's prompt, the prompt and what is typed are shown as in any terminal. Without keys, it waits for
        something to change.

        Args:
            keys: In the notation of ``keys.py``.
            wait_s: Seconds to wait at most.

        Raises:
            MachineLostError, EngineError: As ``run`` has them.
        """
        restarted = self._catch_up(None)
        session = self._opened()
        try:
            self._give_to_keys(session)
            changed = self._type_keys(session, keys)
            self._watch(session, wait_s, changed=changed)
        except ShellEndedError as ended:
            restarted, self._ended_with = True, ended.status
            self.close()
            session = self._opened()
            try:
                self._give_to_keys(session)
            except ShellEndedError as again:
                raise MachineLostError("the shell ends as soon as it is started", by_agent=True) from again
        if restarted:
            self._exit_code = self._ended_with
        note = "the shell had ended, and a new one was started" if restarted else ""
        return ScreenResult(
            self._screen.text(),
            running=not session.at_prompt,
            cursor=self._screen.cursor,
            exit_code=self._exit_code if session.at_prompt or restarted else None,
            workdir=session.workdir,
            restarted=restarted,
            note=note,
        )

    def _opened(self) -> Session:
        if self._session is None:
            self._session = open_session(
                self._machine,
                user=self._user,
                workdir=self._workdir,
                env=self._env,
                columns=self._screen.columns,
                lines=self._screen.lines,
                again=self._again,
            )
            self._again = True
        return self._session

    def _result(
        self, output: Output, exit_code: int | None, *, timed_out: bool = False, restarted: bool, note: str
    ) -> CommandResult:
        text, dropped = output.text()
        return CommandResult(text, exit_code, timed_out, dropped, self.workdir, restarted, note=note)

    def _catch_up(self, output: Output | None) -> bool:
        """Take what background jobs wrote meanwhile; tell whether the shell has ended, so that a new one is started."""
        session = self._session
        if session is None:
            return False
        end = time.monotonic() + _QUIET_S
        try:
            while time.monotonic() < end and self._look(session, 0.0, output):
                pass
        except ShellEndedError as ended:
            self.close()
            self._ended_with = ended.status
            return True
        return False

    def _look(self, session: Session, timeout_s: float, output: Output | None = None) -> bool:
        """Take what comes while no command is run; tell whether anything came."""
        came = False
        for event in session.events(timeout_s):
            came = True
            if isinstance(event, Mark):
                if event.kind == "P":
                    session.at_prompt, self._exit_code = True, event.status
            elif session.by_keys:
                self._screen.feed(event)
            elif output is not None:
                output.feed(event)
        return came

    def _take_from_keys(self, session: Session) -> bool:
        """Make the shell ready for commands; tell whether it is, and no program that keys have started holds it."""
        if not session.by_keys:
            return True
        if not session.at_prompt:
            return False
        session.interrupt()
        if not session.set_up(READY_S):
            self._kill_shell(session)
            raise ShellEndedError(None)
        return True

    def _give_to_keys(self, session: Session) -> None:
        if session.by_keys:
            return
        self._exit_code = None
        if not session.give_to_keys():
            self._kill_shell(session)
            raise ShellEndedError(None)
        self._screen.clear()
        self._watch(session, _QUIET_S, quiet_s=_QUIET_S / 5)
        self._exit_code = None

    def _type_keys(self, session: Session, keys: str) -> bool:
        changed = False
        data = key_bytes(keys, application=self._screen.application_keys)
        for start in range(0, len(data), 1024):
            piece = data[start : start + 1024]
            if b"\r" in piece or b"\n" in piece:
                session.at_prompt = False  # until the next prompt
            session.type(piece)
            changed = self._look(session, 0.0) or changed
        return changed

    def _watch(self, session: Session, wait_s: float, *, quiet_s: float = _QUIET_S, changed: bool = False) -> None:
        """Draw what comes, until it has been quiet for a moment or the time is over."""
        end = time.monotonic() + wait_s
        while (left := end - time.monotonic()) > 0:
            came = self._look(session, min(left, quiet_s) if changed else left)
            if changed and not came:
                return
            changed = changed or came

    def _ended(self, ended: ShellEndedError, output: Output) -> CommandResult:
        """Start a new shell after a command that has ended the old one."""
        self.close()
        workdir = self._opened().workdir
        note = f"The shell has ended; a new one was started in {workdir}, without the variables of the old one."
        return self._result(output, ended.status, restarted=True, note=note)

    def _stopped(self, session: Session, output: Output, timeout_s: float) -> CommandResult:
        """End a command whose time is over, with all that it has started."""
        try:
            restarted = not self._stop(session)
            if restarted:
                self._kill_shell(session)
        except ShellEndedError:
            self.close()
            restarted = True
        workdir = self._opened().workdir
        note = (
            f"The command ran longer than {round(timeout_s, 1) or timeout_s:g} s and was killed, with all that it had "
            "started. If it waits for input, start it with <keys>; if it needs longer, give it a longer timeout or "
            "run it in the background"
        )
        if restarted:
            note += f". The shell had to be ended too; a new one was started in {workdir}, without its variables"
        return self._result(output, None, timed_out=True, restarted=restarted, note=f"{note}.")

    def _stop(self, session: Session) -> bool:
        """Interrupt a command, and kill what it has started; tell whether the shell is ready."""
        for wait_s in (0.5, 1.0, READY_S):
            session.type(b"\x03")
            self._watch(session, _INTERRUPTED_S, quiet_s=_INTERRUPTED_S / 10)
            self._kill(session)
            if session.is_ready(wait_s):
                return True
        return session.takes_over() and session.set_up(READY_S)

    def _kill(self, session: Session, *, also_shell: bool = False) -> None:
        """Kill what a command has started, again and again while there is more, until all of it is gone."""
        ours = {session.pid, session.leader}
        now = time.monotonic()
        end, quiet = now + _KILLING_S, now + _DYING_S
        killed: set[tuple[int, int]] = set()
        while time.monotonic() < min(end, quiet):  # what is left when nothing new comes is beyond a signal's reach
            processes = self._machine.processes()
            found = [process for process in processes if also_shell and process.pid in ours]
            if (began := session.beginning) is not None and began.uptime_s is not None:
                found += started_by_command(processes, began.uptime_s, ours, began.pid)
            if not found:
                return
            fresh = [process for process in found if (process.pid, process.started) not in killed]
            if fresh:
                self._machine.kill(fresh)
                killed |= {(process.pid, process.started) for process in fresh}
                quiet = time.monotonic() + _DYING_S

    def _kill_shell(self, session: Session) -> None:
        """End a shell that does not listen, and let the next one begin where it was; earlier jobs go on."""
        try:
            found = self._machine.run(["readlink", f"/proc/{session.pid}/cwd"], user=self._user, timeout_s=5.0)
            if found.exit_code == 0 and found.output.startswith(b"/"):
                session.workdir = found.output.decode("utf-8", "replace").rstrip("\n")
            self._kill(session, also_shell=True)
        except MachineError:
            why = self._machine.why_lost()
            if why is not None:
                raise why from None
        self.close()


def started_by_command(
    processes: Sequence[Process], uptime_s: float, ours: set[int], background: int = 0
) -> list[Process]:
    """Return the processes that a command has started, also those in sessions of their own.

    Those are the ones that are younger than the command, unless they come from a process that is older, the shell
    apart: an earlier background job may start what it likes. A process whose parent has ended belongs to the first one,
    and is the command's when it is younger.

    Args:
        processes: All there are.
        uptime_s: Seconds since the start of the machine when the command began, as its shell read them.
        ours: Numbers of the shell and of the process that started it.
        background: Number of the last process that was put in the background before; 0 for none.
    """
    by_number = {process.pid: process for process in processes}
    since = round(uptime_s * _TICKS)

    def is_started(process: Process) -> bool:
        while process.started >= since and process.pid not in ours and process.pid != background:
            if process.parent == 0:
                return False  # put there from outside, as a verifier is
            if process.parent in (1, *ours) or process.parent not in by_number:
                return True
            process = by_number[process.parent]
        return False

    return [process for process in processes if is_started(process)]
