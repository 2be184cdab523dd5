"""The processes that run code, forked from the one that has imported the usual libraries."""

from __future__ import annotations

import contextlib
import fcntl
import gc
import importlib
import itertools
import os
import signal
import socket
import sys
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

from gem_tools.python.inside import child, confine, folders, kernel, runner, syscalls, usage, walls

AHEAD = 4
"""Processes that wait for calls."""

_REST_S = 2.0
_GIVE_UP_S = 10.0


class Exit(NamedTuple):
    """How a process has ended: its wait status, processor time, largest resident memory, and when."""

    status: int
    cpu_s: float
    max_bytes: int
    at: float


@dataclass(eq=False)
class Process:
    """A process that was forked to run code.

    Args:
        pid: Its process id.
        out: Its standard output.
        err: Its error output.
        job: Socket to it.
        uid: The user that it alone runs as, if any.
        folder: Its private folder.
        exit: How it has ended; None while it lives.
        fresh: Whether it has not run any code yet.
    """

    pid: int
    out: int
    err: int
    job: socket.socket
    uid: int | None
    folder: str
    exit: Exit | None = None
    fresh: bool = True

    def close(self) -> None:
        """Close its streams."""
        os.close(self.out)
        os.close(self.err)
        self.job.close()


class Forks:
    """The forked processes of a sandbox: some wait for calls, one may run, sessions stand still.

    Args:
        settings: Those of the level.
        proc: File descriptor of ``/proc``.
    """

    def __init__(self, settings: dict[str, Any], proc: int) -> None:
        self.settings, self.proc = settings, proc
        self.namespaces: bool = settings["namespaces"]
        self.base: str = settings["base"]
        self.uid: int | None = settings["uid"]
        self.nobody = 0 if self.uid is None else self.uid + settings["uids"]
        self.uids = itertools.cycle(range(self.nobody - settings["uids"], self.nobody))
        self.living: dict[int, Process] = {}
        self.spares: list[Process] = []
        self.left: list[Process] = []
        self.folder_limits = {"folder_mb": settings["folder_mb"], "folder_files": settings["folder_files"]}
        self.clean: object = None
        self.filter = syscalls.Filter(sockets=self.namespaces, only_own=settings["same_user"])
        self.wake, wake_in = (high(end) for end in os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC))
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(wake_in, warn_on_full_buffer=False)

    def start(self) -> dict[str, Any]:
        """Import libraries, get ready to be forked, and return what the library should know."""
        confine.raise_oom_score()
        found = {"filtered": self.filter.works(), "walled": not self.namespaces and walls.version() > 0}
        self.settings |= found
        walls.readable()  # found out once, ahead of all forks
        if self.namespaces:
            self.mount_folder(first=True)  # libraries may want to write when they are imported
            child.at_home(confine.FOLDER)
        else:
            os.mkdir(self.base, 0o711)
            os.chmod(self.base, 0o711)
        preload(self.settings["preload"])
        runner.quiet()
        runner.make_streams()
        # This process is in a session of its own, where no signal comes to it; and its children need not set them.
        runner.usual_signals()
        if self.namespaces:
            kernel.end_on(signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF)
        # Code that imports these finds what is installed, if anything.
        self.own_modules = [sys.modules.pop(name) for name in list(sys.modules) if name.split(".")[0] == "gem_tools"]
        self.space_bytes, self.memory_bytes = usage.own_memory()
        if self.namespaces:
            self.own_namespace = high(os.open("self/ns/pid", os.O_RDONLY | os.O_CLOEXEC, dir_fd=self.proc))
            kernel.unmount("/proc")
            self.mount_folder()
        else:
            kernel.prctl(kernel.PR_SET_CHILD_SUBREAPER, 1)
        gc.collect()
        gc.freeze()
        return found

    def fork(self, session: dict[str, Any] | None) -> Process:
        """Fork a process that waits for its code.

        Args:
            session: The limits of the session that it is for; None for a single call.

        Raises:
            OSError: There are too many processes.
        """
        # Each process has a user of its own, unless a namespace keeps it apart.
        taken = {process.uid for process in self.living.values()}
        shared = self.uid is None or self.namespaces
        uid = self.uid if shared else next(uid for uid in self.uids if uid not in taken)
        folder = confine.FOLDER if self.namespaces else folders.make(self.base, uid)
        (out, out_in), (err, err_in) = os.pipe2(os.O_CLOEXEC), os.pipe2(os.O_CLOEXEC)
        job, job_in = socket.socketpair()
        # In their places here already: what a forked process does not do, it need not copy memory for.
        for source, target in ((out_in, 1), (err_in, 2), (job_in.detach(), child.JOB)):
            os.dup2(source, target, inheritable=target != child.JOB)
            os.close(source)
        for descriptor in (out, err, job.fileno()):
            os.set_blocking(descriptor, False)
        process = Process(0, out, err, job, uid, folder)
        try:
            if self.namespaces:
                kernel.unshare(kernel.NEWPID)
            process.pid = kernel.fork()
            if process.pid == 0:
                child.run(
                    child.ForkContext(self.settings, self.proc, self.filter, self.space_bytes, uid, folder, session)
                )
        except OSError:
            process.close()
            raise
        finally:
            if self.namespaces:
                kernel.setns(self.own_namespace, kernel.NEWPID)
            for target in (1, 2, child.JOB):
                os.dup2(0, target, inheritable=False)
        self.living[process.pid] = process
        return process

    def fork_ahead(self) -> None:
        """Have some processes wait for the next calls, whose callers then need not wait 1 ms each.

        They are forked in a row, since after a fork this process has to copy each page that it writes to: with four it
        copies 150 a call, with one 300, and serves a tenth more calls a second.
        """
        with contextlib.suppress(OSError):  # the next call tries again, and tells
            while len(self.spares) < AHEAD:
                self.spares.append(self.fork(None))

    def take(self, limits: dict[str, Any]) -> Process:
        """Return a process for a call with these limits.

        Raises:
            OSError: None can be forked.
        """
        if limits["session"]:
            return self.fork(limits)
        wanted = {name: limits[name] for name in self.folder_limits}
        if self.namespaces and wanted != self.folder_limits:
            self.folder_limits = wanted
            self.mount_folder()
        while self.spares:
            process = self.spares.pop(0)
            if process.exit is None:
                return process
            process.close()
        return self.fork(None)

    def kill(self, process: Process) -> None:
        """Kill a process, and with it all that it started."""
        if process.exit is None:
            os.kill(process.pid, signal.SIGKILL)

    def finish(self, process: Process) -> None:
        """Kill a process unless it has ended, and wait for its end."""
        self.kill(process)
        self.wait_for(process)
        process.close()

    def wait_for(self, process: Process) -> None:
        """Wait for the end of a process."""
        while process.exit is None:
            self.reap(wait=True)

    def reap(self, *, wait: bool = False) -> None:
        """Note the processes that have ended, each after all that it started."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.wake, 4096)
        while True:
            try:
                pid, status, used = os.wait4(-1, 0 if wait else os.WNOHANG)
            except ChildProcessError:
                return
            if pid == 0:
                return
            process = self.living.pop(pid, None)
            if process is None:
                continue  # a process that some call has left, which has no parent any more
            at = time.monotonic()
            if not self.namespaces:
                self.end_strays(process.uid)
            process.exit = Exit(status, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024, at)
            self.left.append(process)
            wait = False

    def clean_up(self) -> None:
        """Remove the files that calls have left; their answers need not wait for this, which takes 1 ms or more."""
        left, self.left = self.left, []
        if self.namespaces:
            if left and self.folder_state() != self.clean:
                self.mount_folder()
            return
        for process in left:
            folders.remove(process.folder)
            if process.uid is not None:
                clear_shared(process.uid)

    def of_call(self, process: Process) -> list[int]:
        """Return the processes of the call that runs: all that there are, but for those of others."""
        return usage.descendants(self.proc, os.getpid(), frozenset(self.living) - {process.pid})

    def strays(self) -> list[int]:
        """Return the processes that have lost their own parent to this one; where there are namespaces, none does."""
        return [pid for pid in usage.children(self.proc, os.getpid()) if pid not in self.living]

    def end_strays(self, uid: int | None) -> None:
        """Kill what a call has left, until there is nothing.

        Whoever loses its parent becomes a child of this process, and leaves its own children to it when it dies. So
        nothing is left once this process has no child that it does not know.

        Args:
            uid: The user that no process but those of the call has; None where there is none.
        """
        while strays := self.strays():
            if uid is not None:
                confine.kill_user(uid, self.nobody)
            # All at once, and none is waited for: while some are killed, others fork.
            found = list(strays)
            while found:
                pid = found.pop()
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
                found += usage.children(self.proc, pid)
            with contextlib.suppress(ChildProcessError):
                for pid in strays:
                    os.waitpid(pid, os.WNOHANG)

    def still(self, process: Process) -> None:
        """Stop a session between its calls, and kill what it started; one that will not rest is ended."""
        pid, until, rested = process.pid, time.monotonic() + _REST_S, 0
        # Looked at twice: a list of children may miss one while another is taken off it.
        while rested < 2:
            if time.monotonic() > until:
                os.kill(pid, signal.SIGKILL)
                break
            os.kill(pid, signal.SIGSTOP)
            ended = os.waitid(os.P_PID, pid, os.WSTOPPED | os.WEXITED | os.WNOHANG | os.WNOWAIT)
            if ended is None:
                time.sleep(0.0001)
                continue
            if ended.si_code != os.CLD_STOPPED:
                break
            # Stopped, it cannot fork. Those that it started can, and can wake it: then all begins again.
            busy = [*usage.children(self.proc, pid), *([] if self.namespaces else self.strays())]
            rested = 0 if busy else rested + 1
            for each in busy:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(each, signal.SIGKILL)
        self.reap()

    def wake_up(self, process: Process) -> None:
        """Let a session run again, without what it left in its socket."""
        with contextlib.suppress(OSError):
            while process.job.recv(1 << 18):
                pass
        os.kill(process.pid, signal.SIGCONT)

    def folder_state(self) -> object:
        """Return what changes when anything is made, removed or permitted at the top of the folder."""
        found, system = os.stat(confine.FOLDER), os.statvfs(confine.FOLDER)
        # Times alone would not do: they have the steps of the kernel's clock, some milliseconds.
        times = found.st_mtime_ns, found.st_ctime_ns
        return *times, found.st_nlink, found.st_mode, system.f_ffree, system.f_bfree

    def mount_folder(self, *, first: bool = False) -> None:
        """Mount a new folder in the place of the old one."""
        if not first:
            kernel.unmount(confine.FOLDER)
        uid = os.getuid() if self.uid is None else self.uid
        confine.mount_folder(self.folder_limits, f",uid={uid},gid={uid}")
        self.clean = self.folder_state()

    def end(self) -> None:
        """End every process and remove every folder."""
        uids = {process.uid for process in self.living.values()}
        for process in self.living.values():
            self.kill(process)
        until = time.monotonic() + _GIVE_UP_S
        while self.living and time.monotonic() < until:
            self.reap(wait=True)
        if not self.namespaces:
            for uid in uids:
                self.end_strays(uid)
            folders.remove(self.base)


def high(descriptor: int) -> int:
    """Move a file descriptor out of the way of those that a forked process gets."""
    moved = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 64)
    os.close(descriptor)
    return moved


def clear_shared(uid: int) -> None:
    """Remove what a call has left in the machine's shared memory; each has a user id of its own."""
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(confine.SHARED)):
            with contextlib.suppress(OSError):
                if entry.stat(follow_symlinks=False).st_uid == uid:
                    folders.remove(entry.path)


def preload(names: list[str]) -> None:
    """Import libraries, but for those that fail; code that needs one of these will see how."""
    for name in names:
        with contextlib.suppress(BaseException):  # it may fail in any way
            importlib.import_module(name)
