"""The process that is forked for a call, or for a session: it shuts itself in and runs the code."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import random
import signal
import socket
import sys
import traceback
from dataclasses import dataclass
from typing import Any, NoReturn

from gem_tools.python.inside import confine, kernel, runner, syscalls, walls

JOB = 3
"""File descriptor of the socket to the first process.

On it a process says ``+`` when code begins, or ``-`` and why it cannot; then the result of each piece of code, as a
line of JSON. It gets what was asked there, with files that hold code and input.
"""

_NICE = 19
"""Of code in a machine of its own: it yields to the process that watches its limits. Elsewhere it would yield to the
whole machine, and run out of time."""

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
        kind: Limits that hold from the start: size and number of files of its folder, and whether it is for a session.
    """

    settings: dict[str, Any]
    proc: int
    filter: syscalls.Filter
    base_bytes: int
    uid: int | None
    folder: str
    kind: dict[str, Any]


def main(context: ForkContext, streams: tuple[int, ...]) -> NoReturn:
    """Be the forked process.

    Args:
        context: What it finds.
        streams: Its output, its error output, and its end of the socket.
    """
    code = 1
    try:
        for target, source in enumerate(streams, start=1):
            os.dup2(source, target, inheritable=target != JOB)
        code = _run(context)
    except BaseException:  # noqa: BLE001 - whatever it was, this process must not go on as its parent
        with contextlib.suppress(BaseException):
            traceback.print_exc()
    os._exit(code)


def _run(context: ForkContext) -> int:
    """Return the exit code."""
    fault = None
    try:
        _shut_in(context)
    except Exception as error:  # noqa: BLE001 - told once there is someone to tell it to
        fault = error
    os.closerange(JOB + 1, 1024)
    _look_new()
    program = runner.Program()
    told, code = _receive()
    try:
        if fault is not None:
            raise fault
        os.chdir(context.folder)
        if not context.settings["namespaces"]:
            at_home(context.folder)
        _name_input(code, context)
        confine.limit(told["limits"], told["others"], context.base_bytes)
    except BaseException as error:  # noqa: BLE001 - told as a failure of the sandbox, not of the code
        _say(f"-{type(error).__name__}: {error}".encode("utf-8", "replace"))
        return 1
    _say(b"+")
    while True:
        outcome = program.run(code, wants_value=told["value"], most=told["limits"]["value_chars"])
        if not context.kind["session"]:
            program.end()
            _report(outcome)
            return int(outcome["code"])
        runner.flush()
        _report(outcome)
        # A session is stopped here until its next call.
        told, code = _receive()
        # Children that were killed between two calls.
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        # Code that broke its streams has broken them for itself.
        with contextlib.suppress(Exception):
            if os.fstat(0).st_size:
                sys.stdin = runner.input_stream()
            _name_input(code, context)


def _shut_in(context: ForkContext) -> None:
    """Give up all rights that code must not have."""
    settings = context.settings
    if settings["own_machine"]:
        os.nice(_NICE)
    confine.enter(settings, context.proc, context.uid, context.kind)
    # A first process without root's rights may look into dumpable processes of its own user, and see how much memory
    # they share; namespaces or walls keep other calls from doing so.
    kept_apart = settings["namespaces"] or settings["walled"]
    kernel.prctl(kernel.PR_SET_DUMPABLE, int(kept_apart and settings["uid"] is None))
    kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)
    if settings["walled"]:
        walls.put_up(context.folder, shared=settings["own_machine"] or not settings["same_user"])
    kernel.drop_capabilities()
    if settings["filtered"] and not context.filter.set():
        raise OSError("the filter of system calls could not be set")


def _look_new() -> None:
    """Make a forked interpreter look like one that has just started."""
    signal.set_wakeup_fd(-1)
    for number in (signal.SIGCHLD, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if os.getpid() == 1:
        kernel.end_on(signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF)
    gc.enable()
    random.seed()  # noqa: TID251 - each process draws its own numbers
    if "numpy.random" in sys.modules:
        sys.modules["numpy.random"].seed()
    runner.make_streams()


def _name_input(code: str, context: ForkContext) -> None:
    """Put the input in the folder where code opens it by name and there is no ``/proc``."""
    if context.settings["namespaces"] and any(name in code for name in _INPUT_NAMES):
        runner.name_input()


def _receive() -> tuple[dict[str, Any], str]:
    """Wait for the next call; return what was asked, and its code. Its input becomes standard input."""
    with socket.socket(fileno=os.dup(JOB)) as channel:
        data, (job, given), _, _ = socket.recv_fds(channel, 1 << 16, 2)
    os.dup2(given, 0)
    os.close(given)
    with open(job, "rb") as stream:
        return json.loads(data), stream.read().decode("utf-8", "surrogatepass")


def _say(data: bytes) -> None:
    """Tell the first process something."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(JOB, rest) :]


def _report(outcome: dict[str, Any]) -> None:
    """Send the result; a socket that the code has closed tells nothing."""
    with contextlib.suppress(BaseException):
        os.set_blocking(JOB, True)
        _say(json.dumps(outcome).encode("ascii") + b"\n")


def at_home(folder: str) -> None:
    """Let programs and imports look into the folder of a call."""
    os.environ["HOME"] = os.environ["TMPDIR"] = folder
    sys.path.insert(0, folder)
