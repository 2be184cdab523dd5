"""The process that all code is forked from. It has imported the usual libraries and never sees any call's data."""

from __future__ import annotations

import contextlib
import gc
import importlib
import itertools
import json
import os
import select
import signal
import socket
import sys
import time
import traceback
from typing import Any

from gem_tools.python.inside import confine, folders, kernel, runner, syscalls, walls, watch, wire

_JOB = 3
_REST_S = 2.0
_GIVE_UP_S = 10.0
_INPUT_NAMES = ("/dev/stdin", "/dev/fd/")


class Zygote:
    """Forks a process when its keeper asks for one, and tells the keeper when one has ended.

    Args:
        settings: Those of the level.
        control: Socket to the keeper.
        proc: File descriptor of ``/proc``.
    """

    def __init__(self, settings: dict[str, Any], control: socket.socket, proc: int) -> None:
        self.settings, self.control, self.proc = settings, control, proc
        self.namespaces: bool = settings["namespaces"]
        self.folders = None if self.namespaces else _folders(settings["base"])
        self.uid: int | None = settings["uid"]
        self.nobody = 0 if self.uid is None else self.uid + settings["uids"]
        self.uids = itertools.cycle(range(self.nobody - settings["uids"], self.nobody))
        self.children: dict[int, tuple[str, int | None]] = {}
        self.folder_limits = {"folder_mb": settings["folder_mb"], "folder_files": settings["folder_files"]}
        self.clean: object = None
        self.base_bytes = 0
        self.calls = syscalls.Filter(sockets=self.namespaces, only_own=settings["same_user"])
        self.wake, wake_in = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(wake_in, warn_on_full_buffer=False)

    def main(self) -> None:
        """Serve until the keeper is gone."""
        confine.go_first()
        self.settings["filtered"] = self.calls.works()
        self.settings["walled"] = not self.namespaces and walls.version() > 0
        walls.readable()  # found out once, ahead of all forks
        if self.folders is None:
            self.mount_folder(first=True)  # libraries may want to write when they are imported
            at_home(confine.FOLDER)
        failed = preload(self.settings["preload"])
        runner.quiet()
        runner.make_streams()
        # No signal comes to this process, which is in a session of its own; and its children need not set them.
        runner.usual_signals()
        if self.namespaces:
            kernel.end_on(signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF)
        # Code that imports these finds what is installed, if anything.
        self.own_modules = [sys.modules.pop(name) for name in list(sys.modules) if name.split(".")[0] == "gem_tools"]
        if self.namespaces:
            self.own_namespace = os.open("self/ns/pid", os.O_RDONLY | os.O_CLOEXEC, dir_fd=self.proc)
            space, anonymous = watch.own_memory()
            kernel.unmount("/proc")
            self.mount_folder()
        else:
            space, anonymous = watch.own_memory()
            kernel.prctl(kernel.PR_SET_CHILD_SUBREAPER, 1)
        self.base_bytes = space
        gc.collect()
        gc.freeze()
        gc.disable()
        found = {name: self.settings[name] for name in ("filtered", "walled")}
        self.tell({"op": "ready", "failed": failed, "base_bytes": anonymous, **found})
        poller = select.poll()
        poller.register(self.control, select.POLLIN)
        poller.register(self.wake, select.POLLIN)
        while True:
            for descriptor, _ in poller.poll():
                if descriptor == self.wake:
                    with contextlib.suppress(BlockingIOError):
                        os.read(self.wake, 4096)
                    self.reap()
                elif not self.serve():
                    self.quit()
                    return

    def tell(self, message: dict[str, Any]) -> None:
        """Send the keeper a message; one that is gone is noticed when its socket is read."""
        with contextlib.suppress(OSError):
            self.control.send(json.dumps(message).encode())

    def serve(self) -> bool:
        """Do what the keeper asks next; False when it is gone or wants an end."""
        try:
            data, descriptors, _, _ = socket.recv_fds(self.control, 4096, 3)
        except OSError:
            return False
        if not data:
            return False
        message = json.loads(data)
        operation, pid = message["op"], message.get("pid")
        if operation == "spawn":
            self.spawn(descriptors)
        elif operation == "kill" and pid in self.children:
            os.kill(pid, signal.SIGKILL)
        elif operation == "continue" and pid in self.children:
            os.kill(pid, signal.SIGCONT)
        elif operation == "still":
            self.still(pid)
        elif operation == "folder":
            self.folder_limits = message["limits"]
            self.mount_folder()
            self.tell({"op": "folder"})
        return bool(operation != "quit")

    def spawn(self, descriptors: list[int]) -> None:
        """Fork a process that waits for its code."""
        uid = self.free_uid()
        folder = confine.FOLDER if self.folders is None else self.folders.make(uid)
        pid = -1
        try:
            if self.namespaces:
                kernel.unshare(kernel.NEWPID)
            pid = kernel.fork()
        except OSError as error:
            self.tell({"op": "spawned", "pid": None, "error": str(error)})
        if pid == 0:
            run_child(self, descriptors, uid, folder)
        if self.namespaces:
            kernel.setns(self.own_namespace, kernel.NEWPID)
        for descriptor in descriptors:
            os.close(descriptor)
        if pid > 0:
            self.children[pid] = folder, uid
            self.tell({"op": "spawned", "pid": pid, "uid": uid, "folder": folder})

    def free_uid(self) -> int | None:
        """Return the user that the next process runs as: its own one, but where a namespace keeps it apart."""
        if self.uid is None or self.namespaces:
            return self.uid
        taken = {uid for _, uid in self.children.values()}
        return next(uid for uid in self.uids if uid not in taken)

    def reap(self) -> None:
        """Tell of the processes that have ended, each after all that it started."""
        while True:
            try:
                pid, status, used = os.wait4(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if pid == 0:
                return
            known = self.children.pop(pid, None)
            if known is None:
                continue  # a stray of some call, which has no parent any more
            folder, uid = known
            at = time.monotonic()
            if self.folders is not None:
                # Clearing up may take long, and is not part of the call's time.
                self.tell({"op": "ended", "pid": pid, "at": at})
                self.end_strays(uid)
                self.folders.remove(folder)
                if uid is not None:
                    clear_shared(uid)
            elif self.folder_state() != self.clean:
                self.mount_folder()
            cpu_s = used.ru_utime + used.ru_stime
            facts = {"status": status, "cpu_s": cpu_s, "maxrss_kb": used.ru_maxrss, "at": at}
            self.tell({"op": "exited", "pid": pid, **facts})

    def strays(self) -> list[int]:
        """Return the processes that have lost their own parent to this one; where there are namespaces, none does."""
        known = self.children
        return [pid for pid in watch.children(self.proc, os.getpid()) if pid not in known]

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
                found += watch.children(self.proc, pid)
            with contextlib.suppress(ChildProcessError):
                for pid in strays:
                    os.waitpid(pid, os.WNOHANG)

    def still(self, pid: int) -> None:
        """Stop a session between its calls, and kill what it started; one that will not rest is ended."""
        until, rested = time.monotonic() + _REST_S, 0
        # Looked at twice: a list of children may miss one while another is taken off it.
        while pid in self.children and rested < 2:
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
            busy = [*watch.children(self.proc, pid), *([] if self.namespaces else self.strays())]
            rested = 0 if busy else rested + 1
            for each in busy:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(each, signal.SIGKILL)
        self.tell({"op": "still", "pid": pid})

    def folder_state(self) -> object:
        """Return what changes when anything is made, removed or permitted at the top of the folder."""
        found, system = os.stat(confine.FOLDER), os.statvfs(confine.FOLDER)
        # Times alone would not do: they have the steps of the kernel's clock, some milliseconds.
        times = found.st_mtime_ns, found.st_ctime_ns
        return *times, found.st_nlink, found.st_mode, system.f_ffree, system.f_bfree

    def mount_folder(self, *, first: bool = False) -> None:
        """Mount a new folder in the place of the old one."""
        if self.folders is not None:
            return
        if not first:
            kernel.unmount(confine.FOLDER)
        uid = self.settings["uid"]
        owner = f",uid={uid},gid={uid}" if uid is not None else f",uid={os.getuid()},gid={os.getgid()}"
        confine.mount_folder(self.folder_limits, owner)
        self.clean = self.folder_state()

    def quit(self) -> None:
        """End every process and remove every folder."""
        uids = {uid for _, uid in self.children.values()}
        for pid in list(self.children):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        until = time.monotonic() + _GIVE_UP_S
        while self.children and time.monotonic() < until:
            with contextlib.suppress(ChildProcessError):
                self.children.pop(os.waitpid(-1, 0)[0], None)
        if self.folders is not None:
            for uid in uids:
                self.end_strays(uid)
            self.folders.remove_all()


def _folders(base: str) -> folders.Folders:
    os.mkdir(base, 0o711)
    return folders.Folders(base)


def clear_shared(uid: int) -> None:
    """Remove what a call has left in the machine's shared memory; each has a user id of its own."""
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(confine.SHARED)):
            with contextlib.suppress(OSError):
                if entry.stat(follow_symlinks=False).st_uid == uid:
                    folders.remove(entry.path)


def preload(names: list[str]) -> list[str]:
    """Import libraries; return those that could not be."""
    failed = []
    for name in names:
        try:
            importlib.import_module(name)
        except BaseException:  # noqa: BLE001 - a library may fail in any way; code that needs it will see how
            failed.append(name)
    return failed


def run_child(zygote: Zygote, descriptors: list[int], uid: int | None, folder: str) -> None:
    """Be the forked process: wait for code, run it, end. Never returns."""
    code = 1
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        for source, target in zip(descriptors, (1, 2, _JOB), strict=True):
            if source != target:
                os.dup2(source, target, inheritable=target != _JOB)
        job = socket.socket(fileno=_JOB)
        confine.enter(zygote.settings, zygote.proc, uid)
        os.closerange(_JOB + 1, 1024)
        code = Child(zygote, job, folder).main()
    except BaseException:  # noqa: BLE001 - whatever it was, this process must not go on as its parent
        with contextlib.suppress(BaseException):
            traceback.print_exc()
    os._exit(code)


class Child:
    """Waits for code, then runs it; in a session again and again."""

    def __init__(self, zygote: Zygote, job: socket.socket, folder: str) -> None:
        self.settings, self.calls, self.base_bytes = zygote.settings, zygote.calls, zygote.base_bytes
        self.job, self.folder = job, folder
        self.reader = wire.Reader()
        self.walls: walls.Walls | None = None
        self.fault: OSError | None = None

    def receive(self) -> tuple[dict[str, Any], bytes] | None:
        """Return the next message; None when the keeper is gone."""
        while data := self.job.recv(1 << 16):
            messages = self.reader.feed(data)
            if messages:
                return messages[0]
        return None

    def main(self) -> int:
        """Return the exit code."""
        warm_up()
        # A keeper without root's rights may look into dumpable processes of its own user, and see how much memory they
        # share; namespaces or walls keep other calls from doing so.
        kept_apart = self.settings["namespaces"] or self.settings["walled"]
        kernel.prctl(kernel.PR_SET_DUMPABLE, int(kept_apart and self.settings["uid"] is None))
        if self.settings["walled"]:
            self.make_walls()
        message = self.receive()
        if message is None:
            return 0
        limits = message[0]["limits"]
        job = json.loads(message[1])
        try:
            self.set_up(limits, job)
        except BaseException as error:  # noqa: BLE001 - told as a failure of ours, not of the code
            self.say({"error": f"{type(error).__name__}: {error}"})
            return 1
        program = runner.Program()
        self.say({"at": time.monotonic()})
        while True:
            outcome = program.run(job["code"], wants_value=job["value"], most=job["most"])
            if not limits["session"]:
                program.end()
                self.report(outcome)
                return int(outcome["code"])
            runner.flush()
            self.report(outcome)
            # Here the session is stopped until its next call.
            message = self.receive()
            if message is None:
                return 0
            reap_zombies()
            job = json.loads(message[1])
            self.next_input(job)

    def make_walls(self) -> None:
        """Make the walls ahead; a failure is told once there is someone to tell it to."""
        shared = self.settings["own_machine"] or not self.settings["same_user"]
        try:
            self.walls = walls.Walls(self.folder, shared=shared)
        except OSError as error:
            self.fault = error

    def set_up(self, limits: dict[str, Any], job: dict[str, Any]) -> None:
        """Get ready for code that nobody trusts."""
        if limits["session"] and self.settings["namespaces"]:
            confine.leave_others(limits)
        os.chdir(self.folder)
        if not self.settings["namespaces"]:
            at_home(self.folder)
        runner.prepare(job["stdin"], job["files"], named=self.names_input(job))
        confine.limit(limits, self.settings, self.base_bytes)
        if self.fault is not None:
            raise self.fault
        if self.walls is not None:
            self.walls.put_up()
        confine.give_up_rights(self.calls, self.settings)

    def next_input(self, job: dict[str, Any]) -> None:
        """Put a later call's standard input and files in place; code that broke these streams has broken them."""
        with contextlib.suppress(Exception):
            runner.prepare_again(job["stdin"], job["files"], named=self.names_input(job))

    def names_input(self, job: dict[str, Any]) -> bool:
        """Tell whether code asks for its input by a name; a file that most never look at would cost them time."""
        return bool(self.settings["namespaces"]) and any(name in job["code"] for name in _INPUT_NAMES)

    def say(self, what: dict[str, Any]) -> None:
        """Tell the keeper something: that this process is ready, or why not, and then each result."""
        self.job.sendall(wire.frame(runner.as_json(what)))

    def report(self, outcome: dict[str, Any]) -> None:
        """Send what became of the code; a socket that the code has closed tells nothing."""
        with contextlib.suppress(BaseException):
            self.job.setblocking(True)
            self.say(outcome)


def at_home(folder: str) -> None:
    """Let programs and imports look into the folder of a call."""
    os.environ["HOME"] = os.environ["TMPDIR"] = folder
    sys.path.insert(0, folder)


def warm_up() -> None:
    """Do ahead what every call needs, and touch the memory that every call does, which has to be copied first."""
    kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)
    runner.as_json(runner.Program().run("None", wants_value=True, most=1))
    wire.Reader().feed(wire.pack({"op": "warm"}))
    runner.as_new()


def reap_zombies() -> None:
    """Forget children that were killed between two calls."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
