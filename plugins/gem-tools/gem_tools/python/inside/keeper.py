"""The process that stands between the library and the processes that run code. It runs none itself.

It reads what is asked from its standard input and answers on its standard output; when the input ends, because the
library's process has closed it or died, it ends everything and itself.
"""

from __future__ import annotations

import collections
import contextlib
import fcntl
import json
import os
import select
import signal
import socket
from typing import Any, NoReturn

from gem_tools.python.inside import confine, kernel, memory, wire
from gem_tools.python.inside.call import Call
from gem_tools.python.inside.watch import descendants
from gem_tools.python.inside.zygote import Zygote

_PIECE = 1 << 18


class Child:
    """A process that was forked to run code, as its keeper sees it."""

    def __init__(self, out: int, err: int, job: socket.socket) -> None:
        self.pid = 0
        self.uid: int | None = None
        self.folder = ""
        self.out, self.err, self.job = out, err, job
        self.exit: dict[str, Any] | None = None
        self.ended = False
        self.error: str | None = None
        self.fresh = True
        self.held_bytes = 0

    def close(self) -> None:
        """Close its streams."""
        os.close(self.out)
        os.close(self.err)
        self.job.close()


class Keeper:
    """Runs calls, one at a time, and holds sessions, which are still between their calls.

    Args:
        settings: Those of the level.
        incoming: File descriptor on which the library asks.
        outgoing: File descriptor on which it is answered.
    """

    def __init__(self, settings: dict[str, Any], incoming: int, outgoing: int) -> None:
        self.settings, self.incoming, self.outgoing = settings, incoming, outgoing
        self.proc = _high(os.open("/proc", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC))
        self.control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.zygote = os.fork()
        if self.zygote == 0:
            self._be_zygote(theirs)
        theirs.close()
        self.poller = select.poll()
        self.poller.register(self.control, select.POLLIN)
        self.reader = wire.Reader()
        self.asked: collections.deque[tuple[dict[str, Any], bytes]] = collections.deque()
        self.spare: Child | None = None
        self.spawning: collections.deque[Child] = collections.deque()
        self.children: dict[int, Child] = {}
        self.sessions: dict[str, Child] = {}
        self.stilled: set[int] = set()
        self.call: tuple[int, Call] | None = None
        self.base_bytes = 0
        self.group = memory.group(settings["memory_files"], own_machine=settings["own_machine"])
        self.folder = {"folder_mb": settings["folder_mb"], "folder_files": settings["folder_files"]}
        self.folder_set = True

    def _be_zygote(self, control: socket.socket) -> None:
        code = 1
        try:
            self.control.close()
            os.close(self.incoming)
            os.close(self.outgoing)
            for file in self.settings["memory_files"]:
                os.close(file)
            Zygote(self.settings, control, self.proc).main()
            code = 0
        finally:
            os._exit(code)

    def main(self) -> None:
        """Serve until the library is gone."""
        ready = self.from_zygote()
        self.base_bytes = ready["base_bytes"]
        self.spawn()
        found = {name: ready[name] for name in ("failed", "filtered", "walled")}
        self.send(wire.pack({"op": "ready", **found}))
        self.poller.register(self.incoming, select.POLLIN)
        while True:
            while self.asked:
                self.serve(*self.asked.popleft())
            for descriptor, _ in self.poller.poll():
                self.attend(descriptor)

    def attend(self, descriptor: int) -> None:
        """See to what came from the library or from the zygote."""
        if descriptor == self.incoming:
            self.from_library()
        else:
            self.noted(self.from_zygote())

    def from_library(self) -> None:
        """Read what is asked; at its end, end all."""
        try:
            data = os.read(self.incoming, _PIECE)
        except OSError:
            data = b""
        if not data:
            self.quit()
        for header, body in self.reader.feed(data):
            if header["op"] == "cancel":
                self.cancel(header["id"])
            else:
                self.asked.append((header, body))

    def cancel(self, identifier: int) -> None:
        """End the call that runs, or forget one that waits."""
        if self.call is not None and self.call[0] == identifier:
            self.call[1].end("cancelled")

    def from_zygote(self) -> dict[str, Any]:
        """Return the zygote's next message; without a zygote nothing can go on."""
        data = self.control.recv(4096)
        if not data:
            self.quit(1)
        message: dict[str, Any] = json.loads(data)
        return message

    def noted(self, message: dict[str, Any]) -> None:
        """Keep what the zygote tells."""
        operation = message["op"]
        if operation == "spawned":
            child = self.spawning.popleft()
            if message["pid"] is None:
                child.error = message["error"]
            else:
                child.pid, child.uid, child.folder = message["pid"], message["uid"], message["folder"]
                self.children[child.pid] = child
        elif operation == "ended":
            self.children[message["pid"]].ended = True
        elif operation == "exited":
            ended = self.children.pop(message["pid"], None)
            if ended is not None:
                ended.exit = message
        elif operation == "still":
            self.stilled.add(message["pid"])
        elif operation == "folder":
            self.folder_set = True

    def tell(self, message: dict[str, Any], descriptors: tuple[int, ...] = ()) -> None:
        """Ask the zygote for something."""
        try:
            socket.send_fds(self.control, [json.dumps(message).encode()], descriptors)
        except OSError:
            self.quit(1)

    def send(self, data: bytes) -> None:
        """Answer the library."""
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self.outgoing, view) :]
        except OSError:
            self.quit()

    def spawn(self) -> None:
        """Ask for a process that waits for code."""
        out, out_in = os.pipe2(os.O_CLOEXEC)
        err, err_in = os.pipe2(os.O_CLOEXEC)
        job, job_in = socket.socketpair()
        for descriptor in (out, err):
            os.set_blocking(descriptor, False)
        job.setblocking(False)
        self.spare = Child(out, err, job)
        self.spawning.append(self.spare)
        self.tell({"op": "spawn"}, (out_in, err_in, job_in.fileno()))
        os.close(out_in)
        os.close(err_in)
        job_in.close()

    def take_spare(self) -> Child:
        """Return a process that waits for code.

        Raises:
            OSError: None can be made.
        """
        reason = "it ended"
        for _ in range(3):
            if self.spare is None:
                self.spawn()
            child, self.spare = self.spare, None
            while child is not None and not child.pid and child.error is None:
                self.noted(self.from_zygote())
            if child is not None and child.error is None and child.exit is None:
                return child
            if child is not None:
                reason = child.error or reason
                child.close()
        raise OSError(f"no process could be forked: {reason}")

    def serve(self, header: dict[str, Any], body: bytes) -> None:
        """Do what is asked."""
        operation, session = header["op"], header.get("session")
        if operation == "close":
            child = self.sessions.pop(str(session), None)
            if child is not None:
                self.finish(child)
            self.send(wire.pack({"id": header["id"], "closed": True}))
            return
        child = self.sessions.get(session) if session is not None else None
        if session is not None and child is None and not header["opens"]:
            self.send(wire.pack({"id": header["id"], "gone": True}))
            return
        if child is not None:
            self.wake(child)
        else:
            self.fit_folder(header["limits"])
            try:
                child = self.take_spare()
            except OSError as error:
                self.send(wire.pack({"id": header["id"], "failed": str(error)}))
                return
        call = Call(self, child, header, body)
        self.call = (header["id"], call)
        try:
            call.run()
        except Exception as error:  # noqa: BLE001 - whatever fails, fails for this call alone
            call.failed = f"{type(error).__name__}: {error}"
        finally:
            self.call = None
        if child.exit is None and session is not None and call.failed is None:
            self.sessions[session] = child
        else:
            self.sessions.pop(str(session), None)
            self.finish(child)
        self.send(call.answer(header["id"]))
        if self.spare is None:
            self.spawn()

    def finish(self, child: Child) -> None:
        """See a process to its end."""
        if child.exit is None:
            self.kill(child)
        while child.exit is None:
            self.noted(self.from_zygote())
        child.close()

    def kill(self, child: Child) -> None:
        """Have a process killed, and with it all that it started."""
        self.tell({"op": "kill", "pid": child.pid})

    def still(self, child: Child) -> None:
        """Stop a session, and have what it started killed."""
        self.stilled.discard(child.pid)
        self.tell({"op": "still", "pid": child.pid})
        while child.pid not in self.stilled and child.exit is None:
            self.noted(self.from_zygote())

    def wake(self, child: Child) -> None:
        """Let a session run again, without what it left in its streams."""
        while True:
            try:
                if not child.job.recv(_PIECE):
                    break
            except OSError:
                break
        self.tell({"op": "continue", "pid": child.pid})

    def fit_folder(self, limits: dict[str, Any]) -> None:
        """Give the next call a folder of the size that it may have."""
        wanted = {name: limits[name] for name in self.folder}
        if self.settings["namespaces"] and not limits["session"] and wanted != self.folder:
            self.folder, self.folder_set = wanted, False
            self.tell({"op": "folder", "limits": wanted})
            while not self.folder_set:
                self.noted(self.from_zygote())

    def members(self, child: Child) -> list[int]:
        """Return the processes of the call that runs: all that the zygote has, but for the others' own."""
        others = frozenset(self.children) - {child.pid}
        return descendants(self.proc, self.zygote, others)

    def quit(self, code: int = 0) -> NoReturn:
        """End everything that was started here, and this process."""
        with contextlib.suppress(OSError):
            self.control.send(b'{"op": "quit"}')
        with contextlib.suppress(ChildProcessError):
            os.waitpid(self.zygote, 0)
        os._exit(code)


def main(settings: dict[str, Any]) -> None:
    """Start here, inside the sandbox."""
    incoming, outgoing = (fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, 64) for number in (0, 1))
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 0)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    # The signals of a terminal are for the library's process, which then ends this one.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    if settings["hidden"]:
        confine.hide(settings["hidden"], settings["shown"])
    if not settings["namespaces"]:
        confine.leave_network()
    kernel.prctl(kernel.PR_SET_DUMPABLE, 0)
    confine.open_many()
    # Python's own streams stay as they are, on what is nowhere now; a forked process puts others in their place, and no
    # file that closes its descriptor must go with them.
    Keeper(settings, incoming, outgoing).main()


def _high(descriptor: int) -> int:
    """Move a file descriptor out of the way of those that a forked process gets."""
    high = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 64)
    os.close(descriptor)
    return high
