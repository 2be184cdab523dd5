"""Runs a server as its child and lets nothing of it outlive the process that wanted it. A script, not a module.

``python -I -S keeper.py PARENT_PID COMMAND ARGUMENT…``: the server has the standard streams. When it ends, when the
parent is gone (however it went), or on SIGTERM, all that descends from the server is ended, daemons included: the
keeper is the one to whom the system hands orphans. It starts in some ten milliseconds, and imports little for that.
"""

import contextlib
import os
import select
import signal
import sys
import time

GRACE_S = 0.5
"""How long processes have to end after SIGTERM."""

KILL_S = 5.0
"""How long SIGKILL is repeated; new processes may appear while the old ones are killed."""

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # <linux/prctl.h>
CANNOT_START = 127


def main() -> int:
    """Run the command and return its exit code."""
    parent = int(sys.argv[1])
    wake, alarm = os.pipe()
    os.set_blocking(alarm, False)
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(alarm, warn_on_full_buffer=False)
    asked: list[int] = []
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: asked.append(number))
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(Exception):  # no Linux: the parent is watched by its id alone
        import ctypes

        prctl = ctypes.CDLL(None).prctl
        prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    child = start(sys.argv[2:])
    release_streams()
    status = None
    while status is None and not asked and os.getppid() == parent:
        with contextlib.suppress(InterruptedError):
            select.select([wake], [], [], 1.0)
        with contextlib.suppress(BlockingIOError):
            os.read(wake, 4096)
        status = reap(child)
    if status is None:
        end(child, signal.SIGTERM, GRACE_S)
    end(child, signal.SIGKILL, KILL_S)
    return 0 if status is None else os.waitstatus_to_exitcode(status) & 0xFF


def start(command: list[str]) -> int:
    """Start the server in a session of its own."""
    child = os.fork()
    if child:
        return child
    try:
        os.setsid()
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD, signal.SIGINT, signal.SIGPIPE):
            signal.signal(number, signal.SIG_DFL)
        os.execvp(command[0], command)
    except OSError as error:
        os.write(2, f"cannot start {command[0]}: {error.strerror}\n".encode())
    finally:
        os._exit(CANNOT_START)


def release_streams() -> None:
    """Let go of the pipes, so that their other end sees when the server closes them."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nothing, stream)


def reap(child: int) -> int | None:
    """Collect all children that have ended; return the server's status once it is among them."""
    found = None
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return found
        if pid == 0:
            return found
        if pid == child:
            found = status


def end(child: int, number: int, within_s: float) -> None:
    """Send a signal to all descendants, and again while there are any."""
    deadline = time.monotonic() + within_s
    told: set[int] = set()
    while time.monotonic() < deadline:
        left = descendants()
        if left is None:  # no /proc: the server's process group is all that can be found
            with contextlib.suppress(OSError):
                os.killpg(child, number)
            left = set()
            with contextlib.suppress(ChildProcessError):
                left = {child} if os.waitpid(-1, os.WNOHANG)[0] == 0 else set()
        for pid in left if number == signal.SIGKILL else left - told:
            with contextlib.suppress(OSError):
                os.kill(pid, number)
        told |= left
        reap(child)
        if not left:
            return
        time.sleep(0.005)


def descendants() -> set[int] | None:
    """Return the ids of all processes below this one; None where the system does not tell."""
    children: dict[int, list[int]] = {}
    try:
        names = os.listdir("/proc")
    except OSError:
        return None
    for name in names:
        if name.isdigit():
            with contextlib.suppress(OSError, ValueError, IndexError), open(f"/proc/{name}/stat", "rb") as file:
                state, ppid = file.read().rpartition(b")")[2].split()[:2]
                if state != b"Z":
                    children.setdefault(int(ppid), []).append(int(name))
    if not children:
        return None
    found: set[int] = set()
    waiting = [os.getpid()]
    while waiting:
        below = children.get(waiting.pop(), [])
        waiting += [pid for pid in below if pid not in found]
        found.update(below)
    return found


if __name__ == "__main__":
    # Not sys.exit: nothing is to be flushed or joined.
    os._exit(main())
