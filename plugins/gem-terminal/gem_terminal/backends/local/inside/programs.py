"""Programs: forked from the keeper into a view, with limits and without its powers."""

from __future__ import annotations

import contextlib
import fcntl
import os
import resource
import signal
import struct
import termios
import warnings  # noqa: F401 - os.execvpe imports it, when there is nothing left to import it from
from typing import TYPE_CHECKING, Any, NoReturn

from gem_terminal.backends.local.inside import kernel

if TYPE_CHECKING:
    from gem_terminal.backends.local.inside.views import View

_CANNOT_RUN, _NOT_FOUND = 126, 127
_NOT_ASKED = "gem: cannot run "


def limits(settings: dict[str, Any], *, judge: bool) -> list[tuple[int, int]]:
    """Return the limits of a program, as ``resource`` takes them.

    Args:
        settings: ``memory_mb``, ``processes``, ``storage_mb``.
        judge: Whether it may have more processes than the agent's, which may have left none over.
    """
    mega = 1 << 20
    wanted = [
        (resource.RLIMIT_NPROC, settings["processes"] + 16 + 128 * judge),
        (resource.RLIMIT_DATA, settings["memory_mb"] * mega),
        (resource.RLIMIT_FSIZE, settings["storage_mb"] * mega),
        (resource.RLIMIT_NOFILE, 65_536),
        (resource.RLIMIT_MEMLOCK, 64 * 1024),
        (resource.RLIMIT_CORE, 0),
    ]
    found = []
    for kind, value in wanted:
        hard = resource.getrlimit(kind)[1]
        found.append((kind, value if hard == resource.RLIM_INFINITY else min(value, hard)))
    return found


def start(job: dict[str, Any], view: View, bounds: list[tuple[int, int]], output: int, failure: int) -> int:
    """Fork a program.

    Args:
        job: ``words``, ``env``, ``workdir``, ``terminal``.
        view: Where it runs.
        bounds: Its limits.
        output: File descriptor of its output, or of its terminal.
        failure: File descriptor on which is said that it could not be started; it closes when it has been.
    """
    pid = os.fork()
    if pid == 0:
        _become(job, view, bounds, output, failure)
    return pid


def mind(job: dict[str, Any], view: View, bounds: list[tuple[int, int]], output: int, done: int) -> int:
    """Fork a process that runs a program, adopts what the program leaves behind, and ends with it.

    All that comes from the program is then below the minder, as long as that lives.

    Args:
        job: As in ``start``.
        view: As in ``start``.
        bounds: As in ``start``.
        output: As in ``start``.
        done: File descriptor that gets the exit code as one byte.
    """
    pid = os.fork()
    if pid:
        return pid
    try:
        os.setsid()
        kernel.prctl(kernel.PR_SET_CHILD_SUBREAPER, 1)
        child = start(job, view, bounds, output, -1)
        high = fcntl.fcntl(done, fcntl.F_DUPFD_CLOEXEC, 3)
        os.dup2(high, 3)
        os.closerange(4, 65_536 if high < 65_536 else high + 1)
        os.dup2(os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC), 1)
        os.dup2(1, 2)
        while True:
            ended, status = os.waitpid(-1, 0)
            if ended == child:
                os.write(3, bytes([exit_code(status)]))
                break
    finally:
        os._exit(0)


def helper(words: list[str]) -> tuple[int, int]:
    """Fork a program of ours, with what a judge's may do; return its number and where its output can be read."""
    told, tell = os.pipe2(os.O_CLOEXEC)
    pid = os.fork()
    if pid:
        os.close(tell)
        return pid, told
    try:
        _streams(tell, -1, terminal=False)
        os.dup2(os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC), 2)
        kernel.keep_capabilities(kernel.JUDGE_CAPABILITIES)
        os.execvpe(words[0], words, {"LC_ALL": "C", "PATH": "/usr/bin:/bin"})
    finally:
        os._exit(_NOT_FOUND)


def exit_code(status: int) -> int:
    """Return what a shell makes of how a process ended."""
    code = os.waitstatus_to_exitcode(status)
    return code if code >= 0 else 128 - code


def _become(job: dict[str, Any], view: View, bounds: list[tuple[int, int]], output: int, failure: int) -> NoReturn:
    shown = output
    try:
        os.setsid()
        if job["terminal"]:
            fcntl.ioctl(output, termios.TIOCSCTTY, 0)
        kernel.setns(view.descriptor, kernel.CLONE_NEWNS)
        failure = _streams(output, failure, terminal=job["terminal"])
        shown = 2
        with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
            file.write("500")  # the first to go where the whole machine runs out of memory
        for kind, value in bounds:
            resource.setrlimit(kind, (value, value))
        os.umask(0o022)
        kernel.keep_capabilities(view.capabilities)
        kernel.guard_limits()
        for number in (signal.SIGPIPE, signal.SIGXFSZ, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os.chdir(job["workdir"])
        os.execvpe(job["words"][0], job["words"], job["env"])
    except BaseException as error:  # noqa: BLE001 - a forked process must never return into the keeper's loop
        code = _NOT_FOUND if isinstance(error, FileNotFoundError) else _CANNOT_RUN
        words = f"{_NOT_ASKED}{job['words'][0]!r} in {job['workdir']!r}: {error}\n".encode("utf-8", "replace")
        with contextlib.suppress(OSError):
            os.write(failure if failure >= 0 else shown, words)
        os._exit(code)


def _streams(output: int, failure: int, *, terminal: bool) -> int:
    """Put a program's streams in place, and close all else; return where ``failure`` is now."""
    kept = fcntl.fcntl(failure, fcntl.F_DUPFD_CLOEXEC, 10) if failure >= 0 else -1
    moved = fcntl.fcntl(output, fcntl.F_DUPFD_CLOEXEC, 10)
    source = moved if terminal else os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
    os.dup2(source, 0)
    os.dup2(moved, 1)
    os.dup2(moved, 2)
    last = 3
    if kept >= 0:
        os.dup2(kept, 3, inheritable=False)
        last = 4
    os.closerange(last, 65_536)
    return 3 if kept >= 0 else -1


def window(descriptor: int, columns: int, lines: int) -> None:
    """Set the size of a terminal."""
    fcntl.ioctl(descriptor, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
