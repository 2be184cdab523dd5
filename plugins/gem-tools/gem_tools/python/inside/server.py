"""The first process in a sandbox: it forks a process for each call, keeps the call's limits, and tells its end.

It reads what is asked from its standard input and answers on its standard output; when the input ends, because the
library's process has closed it or died, it ends everything and itself. Code, input and output pass through files and
memory that it does not share with what it forks later.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import importlib
import itertools
import json
import logging
import mmap
import os
import pkgutil
import select
import signal
import socket
import sys
import time
import traceback
from dataclasses import dataclass
from typing import Any, NamedTuple, NoReturn

from gem_tools.python.inside import child, confine, kernel, syscalls, usage, walls, wire

OUT, ERR, RESULT = 0, 1, 2
"""The streams of a call."""

_FIRST_LOOK_S, _NEXT_LOOK_S = 0.02, 0.05
_REST_S = 2.0
_GIVE_UP_S = 10.0
_MAX_RESULT = 1 << 24
_OWN_BYTES = 4 << 20
"""What a process may hold of its interpreter's own beyond its limit, at which it gets a MemoryError by itself."""

_SETUP_S = 30.0
"""Limit of what happens before code begins; what takes longer is a fault of the sandbox."""


class Exit(NamedTuple):
    """How a process has ended: its wait status, processor time, largest resident memory, and when."""

    status: int
    cpu_s: float
    max_bytes: int
    at: float


@dataclass(eq=False)
class Process:
    """A process that was forked to run code, for one call or for a session.

    Args:
        pid: Its process id.
        out: Its standard output.
        err: Its error output.
        job: Socket to it.
        uid: The user that it alone runs as, if any.
        folder: Its private folder.
        exit: How it has ended; None while it lives.
        started: Whether it has begun to run code.
    """

    pid: int
    out: int
    err: int
    job: socket.socket
    uid: int | None
    folder: str
    exit: Exit | None = None
    started: bool = False


class Server:
    """Runs calls, one at a time, and holds sessions, which stand still between their calls.

    Args:
        settings: Those of the level.
        incoming: File descriptor on which the library asks.
        outgoing: File descriptor on which it is answered.
    """

    def __init__(self, settings: dict[str, Any], incoming: int, outgoing: int) -> None:
        self.settings, self.incoming, self.outgoing = settings, incoming, outgoing
        self.namespaces: bool = settings["namespaces"]
        self.base: str = settings["base"]
        self.uid: int | None = settings["uid"]
        self.nobody = 0 if self.uid is None else self.uid + settings["uids"]
        self.uids = itertools.cycle(range(self.nobody - settings["uids"], self.nobody))
        self.living: dict[int, Process] = {}
        self.sessions: dict[str, Process] = {}
        # Waits for the next call, whose caller then need not wait until it is forked.
        self.spare: Process | None = None
        self.usual = {"session": False, "folder_mb": settings["folder_mb"], "folder_files": settings["folder_files"]}
        # No forked process gets this memory: what passes through it stays unknown to later calls.
        self.memory = mmap.mmap(-1, 1 << 16)
        self.memory.madvise(mmap.MADV_DONTFORK)
        self.piece = memoryview(self.memory)
        self.proc = high(os.open("/proc", os.O_RDONLY | os.O_DIRECTORY))
        self.wake, wake_in = (high(end) for end in os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC))
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(wake_in, warn_on_full_buffer=False)

    def start(self) -> None:
        """Import libraries, get ready to be forked, and tell the library."""
        settings = self.settings
        if settings["hidden"]:
            confine.hide(settings["hidden"], settings["shown"])
        if not self.namespaces:
            confine.leave_network()
        kernel.prctl(kernel.PR_SET_DUMPABLE, 0)
        confine.open_many()
        confine.raise_oom_score()
        self.filter = syscalls.Filter(sockets=self.namespaces, only_own=settings["same_user"])
        found = {"filtered": self.filter.works(), "walled": not self.namespaces and walls.version() > 0}
        settings |= found
        walls.readable()  # found out once, ahead of all forks
        if self.namespaces:
            # Libraries may want to write when they are imported.
            confine.mount_folder(self.usual)
            child.at_home(confine.FOLDER)
        else:
            os.mkdir(self.base, 0o711)
            os.chmod(self.base, 0o711)
        for name in settings["preload"]:
            with contextlib.suppress(BaseException):  # code that needs a library that fails will see how
                importlib.import_module(name)
        logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)  # tells of each font that it looks for
        # Code that imports these finds what is installed, if anything.
        self.own_modules = [sys.modules.pop(name) for name in list(sys.modules) if name.split(".")[0] == "gem_tools"]
        self.space_bytes, self.memory_bytes = usage.own_memory()
        if self.namespaces:
            self.own_namespace = high(os.open("self/ns/pid", os.O_RDONLY | os.O_CLOEXEC, dir_fd=self.proc))
            kernel.unmount("/proc")
        else:
            kernel.prctl(kernel.PR_SET_CHILD_SUBREAPER, 1)
        version = "{}.{}".format(*sys.version_info[:2])
        modules = sorted({module.name for module in pkgutil.iter_modules()} - sys.stdlib_module_names)
        gc.collect()
        gc.freeze()
        self.send({**found, "python": version, "modules": modules})

    def serve(self) -> NoReturn:
        """Answer until the library is gone."""
        while True:
            if self.spare is None:
                with contextlib.suppress(OSError):  # the next call tries again, and tells
                    self.spare = self.fork(self.usual)
            header, _ = wire.read_header(self.incoming)
            if header["op"] == "run":
                self.run(header)
            elif header["op"] == "close":
                if (process := self.sessions.pop(header["session"], None)) is not None:
                    self.finish(process)
                self.send({"id": header["id"], "closed": True})

    def run(self, header: dict[str, Any]) -> None:
        """Run a call, and keep its process if its session goes on."""
        job, given = self.receive(header["job"]), self.receive(header["input"])
        session = header.get("session", "")
        process = self.sessions.pop(session, None)
        try:
            if process is None:
                process = self.take(header["limits"])
            self.hand_over(process, header, job, given)
        except OSError as error:
            self.send({"id": header["id"], "failed": f"no process could be forked: {error}"})
            return
        finally:
            os.close(job)
            os.close(given)
        call = Call(self, process, header)
        self.send(call.run())
        if session and process.exit is None and call.failed is None:
            self.sessions[session] = process
        else:
            self.finish(process)

    def receive(self, count: int) -> int:
        """Return a file in memory with the next bytes of what is asked, which nobody can change."""
        memory = os.memfd_create("input", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        while count:
            read = os.readv(self.incoming, [self.piece[:count]])
            if not read:
                raise EOFError
            count -= os.write(memory, self.piece[:read])
        os.lseek(memory, 0, os.SEEK_SET)
        # No limit on memory counts what code could write to it.
        seals = fcntl.F_SEAL_SEAL | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE
        fcntl.fcntl(memory, fcntl.F_ADD_SEALS, seals)
        return memory

    def send(self, header: dict[str, Any], body: bytes | memoryview = b"") -> None:
        """Answer the library."""
        for part in (wire.head(header, len(body)), body):
            rest = memoryview(part)
            while rest:
                rest = rest[os.write(self.outgoing, rest) :]

    # Processes.

    def take(self, limits: dict[str, Any]) -> Process:
        """Return a process for a call or a session with these limits.

        Raises:
            OSError: None can be forked.
        """
        kind = {name: limits[name] for name in self.usual}
        if kind != self.usual or self.spare is None or self.spare.exit is not None:
            return self.fork(kind)
        process, self.spare = self.spare, None
        return process

    def fork(self, kind: dict[str, Any]) -> Process:
        """Fork a process that shuts itself in and waits for code; see ``child.ForkContext``.

        Raises:
            OSError: There are too many processes.
        """
        # Each process has a user of its own, unless a namespace keeps it apart.
        taken = {process.uid for process in self.living.values()}
        shared = self.uid is None or self.namespaces
        uid = self.uid if shared else next(uid for uid in self.uids if uid not in taken)
        folder = confine.FOLDER if self.namespaces else confine.make_folder(self.base, uid)
        (out, out_in), (err, err_in) = os.pipe2(os.O_CLOEXEC), os.pipe2(os.O_CLOEXEC)
        ours, theirs = socket.socketpair()
        for descriptor in (out, err, ours.fileno()):
            os.set_blocking(descriptor, False)
        process = Process(0, out, err, ours, uid, folder)
        try:
            if self.namespaces:
                kernel.unshare(kernel.NEWPID)
            process.pid = kernel.fork()
            if process.pid == 0:
                context = child.ForkContext(self.settings, self.proc, self.filter, self.space_bytes, uid, folder, kind)
                child.main(context, (out_in, err_in, theirs.fileno()))
        except OSError:
            self.close(process)
            raise
        finally:
            if self.namespaces:
                kernel.setns(self.own_namespace, kernel.NEWPID)
            os.close(out_in)
            os.close(err_in)
            theirs.close()
        self.living[process.pid] = process
        return process

    def hand_over(self, process: Process, header: dict[str, Any], job: int, given: int) -> None:
        """Let a process run its next piece of code, without what a session has left in its socket.

        Args:
            process: One that waits.
            header: What was asked.
            job: File with the code.
            given: File with its standard input.
        """
        with contextlib.suppress(OSError):
            while process.job.recv(1 << 18):
                pass
        others = confine.own_tasks() if self.settings["same_user"] else 0
        socket.send_fds(process.job, [json.dumps({**header, "others": others}).encode()], [job, given])
        os.kill(process.pid, signal.SIGCONT)

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
            busy = [*usage.children(self.proc, pid), *self.strays()]
            rested = 0 if busy else rested + 1
            for each in busy:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(each, signal.SIGKILL)
        self.reap()

    def kill(self, process: Process) -> None:
        """Kill a process, and with it all that it started."""
        if process.exit is None:
            os.kill(process.pid, signal.SIGKILL)

    def wait_for(self, process: Process) -> None:
        """Wait for the end of a process."""
        while process.exit is None:
            self.reap(wait=True)

    def finish(self, process: Process) -> None:
        """Kill a process unless it has ended, and remove what it has left."""
        self.kill(process)
        self.wait_for(process)
        self.close(process)

    def close(self, process: Process) -> None:
        """Close the streams of a process that has ended, and remove its files."""
        os.close(process.out)
        os.close(process.err)
        process.job.close()
        if not self.namespaces:
            confine.remove_folder(process.folder)
            if process.uid is not None:
                confine.clear_shared(process.uid)

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
            self.end_strays(process.uid)
            process.exit = Exit(status, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024, at)
            wait = False

    def strays(self) -> list[int]:
        """Return the processes that have lost their own parent to this one; with namespaces, none does."""
        if self.namespaces:
            return []
        return [pid for pid in usage.children(self.proc, os.getpid()) if pid not in self.living]

    def end_strays(self, uid: int | None) -> None:
        """Kill what a call has left, until there is nothing.

        Whoever loses its parent becomes a child of this process, and leaves its own children to it when it dies. So
        nothing is left once this process has no child that it does not know.

        Args:
            uid: The user that no process but those of the call has, if any.
        """
        while strays := self.strays():
            if uid is not None:
                confine.kill_user(uid, self.nobody)
            # All at once, and none is waited for: while some are killed, others fork.
            for pid in usage.tree(self.proc, strays):
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
            with contextlib.suppress(ChildProcessError):
                for pid in strays:
                    os.waitpid(pid, os.WNOHANG)

    def end(self) -> None:
        """End every process and remove every folder."""
        uids = {process.uid for process in self.living.values()}
        for process in self.living.values():
            self.kill(process)
        until = time.monotonic() + _GIVE_UP_S
        while self.living and time.monotonic() < until:
            self.reap(wait=True)
        for uid in uids:
            self.end_strays(uid)
        if not self.namespaces:
            confine.remove_folder(self.base)


class Call:
    """A call that runs.

    Args:
        server: The sandbox.
        process: Runs the code.
        header: What was asked, with its limits.
    """

    def __init__(self, server: Server, process: Process, header: dict[str, Any]) -> None:
        self.server, self.process, self.proc = server, process, server.proc
        self.id: int = header["id"]
        self.session: bool = "session" in header
        self.limits: dict[str, Any] = header["limits"]
        self.streams = {process.out: OUT, process.err: ERR, process.job.fileno(): RESULT}
        self.output_bytes = self.result_bytes = 0
        self.reported = False
        self.failed: str | None = None
        self.ended: str | None = None
        self.began = time.monotonic()
        # No process of a session says when a later call begins: by then it has run code, which may say anything.
        self.started = self.began if process.started else None
        self.cpu_before = usage.cpu_s(self.proc, [process.pid]) if process.started else 0.0
        self.peak_bytes = 0
        self.next_look = self.began + _FIRST_LOOK_S
        self.poller = select.poll()
        for descriptor in (server.incoming, server.wake, *self.streams):
            self.poller.register(descriptor, select.POLLIN)

    def run(self) -> dict[str, Any]:
        """Pass on output and keep the limits until the process has ended or the session has answered; tell the end."""
        while self.process.exit is None and not (self.session and self.reported):
            for descriptor, _ in self.poller.poll(self.keep_limits() * 1000 + 0.5):
                if descriptor == self.server.wake:
                    self.server.reap()
                elif descriptor == self.server.incoming:
                    header, _ = wire.read_header(descriptor)
                    if header["id"] == self.id:
                        self.end("cancelled")
                elif self.read(descriptor) == 0:
                    self.poller.unregister(descriptor)
        return self.finish()

    def keep_limits(self) -> float:
        """End the call where a limit is reached; return the seconds until the next look."""
        now = time.monotonic()
        if self.ended is not None:
            return 1.0
        if self.started is None:
            if now >= self.began + _SETUP_S:
                self.failed = f"a process was not ready within {_SETUP_S:.0f} s"
                self.end("setup")
            return max(0.0, self.began + _SETUP_S - now)
        end: float = self.started + self.limits["wall_s"]
        if now >= end:
            self.end("timeout")
        elif now >= self.next_look:
            self.next_look = now + _NEXT_LOOK_S
            self.look()
        return max(0.0, min(end, self.next_look) - now)

    def end(self, why: str) -> None:
        """Kill the process, and with it all that it started."""
        if self.ended is None:
            self.ended = why
            self.server.kill(self.process)

    def look(self) -> None:
        """Add up what all processes of the call use."""
        most = (self.limits["memory_mb"] << 20) + _OWN_BYTES
        pids, used = self.memory()
        if used > most:
            # While processes end, what they shared is counted for each of those that are left: look again.
            used = min(used, self.memory()[1])
        self.peak_bytes = max(self.peak_bytes, used)
        if used > most:
            self.end("memory")
        elif usage.cpu_s(self.proc, pids) - self.cpu_before > self.limits["cpu_s"]:
            self.end("cpu")

    def memory(self) -> tuple[list[int], int]:
        """Return the processes of the call, and the bytes that they, and files in memory, hold."""
        server, process = self.server, self.process
        pids = usage.tree(self.proc, [process.pid, *server.strays()])
        if server.namespaces:
            files = usage.folder_bytes(self.proc, process.pid, process.folder)
        else:
            files = usage.tree_bytes(process.folder)
            if process.uid is not None:
                files += usage.tree_bytes(confine.SHARED, process.uid)
        return pids, files + usage.memory(self.proc, pids, server.memory_bytes)

    def read(self, descriptor: int) -> int | None:
        """Read what a stream holds now; return how many bytes, 0 at its end, None where nothing has come."""
        stream = self.streams[descriptor]
        if stream == RESULT and (self.reported or self.result_bytes > _MAX_RESULT):
            return 0
        try:
            if stream == RESULT and self.started is None:
                return self.begin()
            count = os.readv(descriptor, [self.server.piece])
        except BlockingIOError:
            return None
        except OSError:
            count = 0
        if count:
            self.server.send({"stream": stream}, self.server.piece[:count])
        if stream != RESULT:
            self.output_bytes += count
            if self.output_bytes > self.limits["output_stop_bytes"]:
                self.end("output")
        elif count:
            self.result_bytes += count
            self.reported = self.server.memory.find(b"\n", 0, count) >= 0
        elif self.session:
            self.end("lost")  # nobody can answer any more; a process that is ending keeps its exit code
        return count

    def begin(self) -> int:
        """Note what a process says before it has seen any code, and can be believed: that code begins, or why not."""
        data = self.process.job.recv(1)
        if data == b"+":
            self.process.started = True
            self.started = time.monotonic()
            self.next_look = self.started + _FIRST_LOOK_S
        elif data:
            self.failed = self.process.job.recv(1000).decode("utf-8", "replace")
        return len(data)

    def finish(self) -> dict[str, Any]:
        """Stop the session, pass on what is left, and return what the library is told of the end."""
        process, now = self.process, time.monotonic()
        if process.exit is None:
            self.cpu_s = usage.cpu_s(self.proc, [process.pid])
            self.server.still(process)
        for descriptor in self.streams:
            while self.read(descriptor) and self.ended != "output":
                pass
        if self.ended is not None:
            self.server.wait_for(process)
        ended, wall_s = process.exit, 0.0
        if ended is not None:
            self.cpu_s = ended.cpu_s
            self.peak_bytes = max(self.peak_bytes, ended.max_bytes - self.server.memory_bytes)
        if self.started is not None:
            wall_s = max(0.0, (now if ended is None else ended.at) - self.started)
            if self.ended == "timeout" and wall_s < self.limits["wall_s"]:
                self.ended = None  # it had ended by itself; the end of what it left took so long
        return {
            "id": self.id,
            "ended": self.ended,
            "failed": self.failed,
            "status": None if ended is None else ended.status,
            "wall_s": wall_s,
            "cpu_s": max(0.0, self.cpu_s - self.cpu_before),
            "peak_bytes": self.peak_bytes,
            "reported": self.reported,
            "lost": self.session and ended is not None,
        }


def high(descriptor: int) -> int:
    """Move a file descriptor out of the way of those that a forked process gets."""
    moved = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 64)
    os.close(descriptor)
    return moved


def main(settings: dict[str, Any]) -> NoReturn:
    """Start here, inside the sandbox."""
    incoming, outgoing, errors = (fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, 64) for number in (0, 1, 2))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2, child.JOB):
        os.dup2(nowhere, number)
    # The signals of a terminal are for the library's process, which then ends this one.
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(each, signal.SIG_IGN)
    server, code = Server(settings, incoming, outgoing), 1
    try:
        server.start()
        server.serve()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        code = 0  # the library is gone
    except BaseException:  # noqa: BLE001 - told on the sandbox's error output, which is no longer this process's
        os.write(errors, traceback.format_exc().encode("utf-8", "replace"))
    finally:
        server.end()
        os._exit(code)
