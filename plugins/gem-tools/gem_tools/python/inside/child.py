"""The process that is forked for a call, or for a session: it shuts itself in, waits for code, and runs it."""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import signal
import struct
import sys
import time
import traceback
from dataclasses import dataclass
from typing import Any, NoReturn

from gem_tools.python.inside import confine, kernel, runner, syscalls, walls, wire

JOB = 3
"""File descriptor of the socket to the keeper."""

AT, LENGTH = struct.Struct("=d"), struct.Struct("=I")
"""What a process says on that socket: when code begins, or -1 and why it cannot; then each result after its length."""

_NICE = 19
"""Of code in a machine of its own: it yields to the keeper, which else loses the processor to many processes, and sees
too late that they use more than they may. Elsewhere it would yield to the whole machine, and run out of time."""

_INPUT_NAMES = ("/dev/stdin", "/dev/fd/")


@dataclass
class ForkContext:
    """What a forked process finds.

    Args:
        settings: Those of the level.
        proc: File descriptor of ``/proc``.
        filter: Of system calls.
        base_bytes: Address space that the interpreter has before it runs any code.
        uid: The user to run code as; None to stay.
        folder: The private folder.
        session: The limits of the session that it is for; None for a single call.
    """

    settings: dict[str, Any]
    proc: int
    filter: syscalls.Filter
    base_bytes: int
    uid: int | None
    folder: str
    session: dict[str, Any] | None


def run(place: ForkContext) -> NoReturn:
    """Be the forked process, whose streams and socket are in their places already."""
    code = 1
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        code = _Child(place).main()
    except BaseException:  # noqa: BLE001 - whatever it was, this process must not go on as its parent
        with contextlib.suppress(BaseException):
            traceback.print_exc()
    os._exit(code)


class _Child:
    def __init__(self, place: ForkContext) -> None:
        self.place, self.settings = place, place.settings
        self.input_left = 0

    def main(self) -> int:
        """Return the exit code."""
        fault = None
        try:
            self.shut_in()
        except Exception as error:  # noqa: BLE001 - told once there is someone to tell it to
            fault = error
        os.closerange(JOB + 1, 1024)
        runner.as_new()
        program = runner.Program()
        if (message := self.receive()) is None:
            return 0
        job = message[1]
        try:
            if fault is not None:
                raise fault
            self.set_up(job, message[0])
        except BaseException as error:  # noqa: BLE001 - told as a failure of the sandbox, not of the code
            self.say(AT.pack(-1) + f"{type(error).__name__}: {error}".encode("utf-8", "replace"))
            return 1
        self.say(AT.pack(time.monotonic()))
        while True:
            outcome = program.run(job["code"], wants_value=job["value"], most=job["most"])
            if self.place.session is None:
                program.end()
                self.report(outcome)
                return int(outcome["code"])
            runner.flush()
            self.report(outcome)
            # The keeper stops a session here until its next call.
            if (message := self.receive()) is None:
                return 0
            self.forget_killed()
            job = message[1]
            # Code that broke its streams has broken them for itself.
            with contextlib.suppress(Exception):
                runner.prepare_again(job["files"], self.pour, named=self.names_input(job))

    def shut_in(self) -> None:
        """Give up, ahead of any call, all rights that code must not have."""
        settings, place = self.settings, self.place
        runner.make_input()  # which the filter would refuse
        if settings["own_machine"]:
            os.nice(_NICE)
        confine.enter(settings, place.proc, place.uid)
        # A keeper without root's rights may look into dumpable processes of its own user, and see how much memory they
        # share; namespaces or walls keep other calls from doing so.
        kept_apart = settings["namespaces"] or settings["walled"]
        kernel.prctl(kernel.PR_SET_DUMPABLE, int(kept_apart and settings["uid"] is None))
        kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)
        if place.session is not None and settings["namespaces"]:
            confine.leave_others(place.session)
        if settings["walled"]:
            walls.put_up(place.folder, shared=settings["own_machine"] or not settings["same_user"])
        confine.give_up_rights(place.filter, settings)

    def set_up(self, job: dict[str, Any], told: dict[str, Any]) -> None:
        """Put files, input and limits of the first call in place."""
        os.chdir(self.place.folder)
        if not self.settings["namespaces"]:
            at_home(self.place.folder)
        runner.prepare(job["files"], self.pour, named=self.names_input(job))
        confine.limit(told["limits"], told["others"], self.place.base_bytes)

    def names_input(self, job: dict[str, Any]) -> bool:
        """Tell whether code asks for its input by a name; a file that most never look at would cost them time."""
        return bool(self.settings["namespaces"]) and any(name in job["code"] for name in _INPUT_NAMES)

    def receive(self) -> tuple[dict[str, Any], Any] | None:
        """Return the next header and the code with its files; None when the keeper is gone. The input stays unread."""
        try:
            header, length = wire.read_header(JOB)
            self.input_left = header["input"]
            return header, json.loads(wire.exactly(JOB, length - self.input_left))
        except EOFError:
            return None

    def pour(self, target: int) -> None:
        """Write the input to a file, through memory that is no forked process's.

        So code that forks a process before it reads its input hides that from it (gem-code's tests do).
        """
        if not self.input_left:
            return
        memory = mmap.mmap(-1, 1 << 16)
        memory.madvise(mmap.MADV_DONTFORK)
        piece = memoryview(memory)
        while self.input_left:
            count = os.readv(JOB, [piece[: self.input_left]])
            if not count:
                raise EOFError
            self.input_left -= count
            rest = piece[:count]
            while rest:
                rest = rest[os.write(target, rest) :]

    def say(self, data: bytes) -> None:
        """Tell the keeper something."""
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(JOB, rest) :]

    def report(self, outcome: dict[str, Any]) -> None:
        """Send the result; a socket that the code has closed tells nothing."""
        with contextlib.suppress(BaseException):
            os.set_blocking(JOB, True)
            data = json.dumps(outcome).encode("ascii")
            self.say(LENGTH.pack(len(data)) + data)

    def forget_killed(self) -> None:
        """Reap the children that were killed between two calls."""
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass


def at_home(folder: str) -> None:
    """Let programs and imports look into the folder of a call."""
    os.environ["HOME"] = os.environ["TMPDIR"] = folder
    sys.path.insert(0, folder)
