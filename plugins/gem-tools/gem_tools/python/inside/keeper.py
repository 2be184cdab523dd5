"""The first process in a sandbox: it stands between the library and the processes that run code, which it forks.

It reads what is asked from its standard input and answers on its standard output; when the input ends, because the
library's process has closed it or died, it ends everything and itself. It knows limits and names of sessions. Code,
input and output pass through memory that it does not share with what it forks.
"""

from __future__ import annotations

import fcntl
import os
import select
import signal
import traceback
from typing import Any, NoReturn

from gem_tools.python.inside import confine, kernel, wire
from gem_tools.python.inside.call import Call, unforked
from gem_tools.python.inside.child import JOB
from gem_tools.python.inside.forks import AHEAD, Forks, Process, high

_IDLE_MS = 20
"""How long no call comes before more processes are forked ahead than none."""


class Keeper:
    """Runs calls, one at a time, and holds sessions, which stand still between their calls.

    Args:
        forks: The processes of this sandbox.
        incoming: File descriptor on which the library asks.
        outgoing: File descriptor on which it is answered.
    """

    def __init__(self, forks: Forks, incoming: int, outgoing: int) -> None:
        self.forks, self.incoming, self.outgoing = forks, incoming, outgoing
        self.poller = select.poll()
        self.sessions: dict[str, Process] = {}
        self.call: Call | None = None
        self.piece = unforked(1 << 16)
        self.body_left = 0

    def main(self) -> NoReturn:
        """Serve until the library is gone."""
        self.send(self.forks.start())
        self.poller.register(self.forks.wake, select.POLLIN)
        self.poller.register(self.incoming, select.POLLIN)
        while True:
            if self.call is None:
                self.forks.clean_up()
            if not self.forks.spares and not self.body_left:
                self.forks.fork_ahead()
            events = self.poller.poll(self.wait_ms())
            if not events and self.call is None:
                self.forks.fork_ahead()
            for descriptor, event in events:
                if descriptor == self.incoming:
                    self.read()
                elif descriptor == self.forks.wake:
                    self.forks.reap()
                elif self.call is not None:
                    self.call.attend(descriptor, event)
            self.read_body()
            if self.call is not None and self.call.over:
                self.finish(self.call)

    def wait_ms(self) -> float | None:
        """Return how long nothing may happen before there is something to do."""
        if self.call is not None:
            return self.call.keep_limits() * 1000 + 0.5
        return None if len(self.forks.spares) == AHEAD else _IDLE_MS

    def read(self) -> None:
        """Read what is asked, and do it."""
        header, self.body_left = wire.read_header(self.incoming)
        if header["op"] != "cancel":
            self.serve(header)
        elif self.call is not None and self.call.id == header["id"]:
            self.call.end("cancelled")

    def read_body(self) -> None:
        """Hand over the code and its input, as fast as the call's process reads."""
        while self.body_left and (self.call is None or not self.call.to_hand_over):
            count = os.readv(self.incoming, [self.piece[: self.body_left]])
            if not count:
                raise EOFError
            self.body_left -= count
            if self.call is not None:
                self.call.hand_over(self.piece[:count])
        self.poller.register(self.incoming, 0 if self.body_left else select.POLLIN)

    def send(self, header: dict[str, Any], body: bytes | memoryview = b"") -> None:
        """Answer the library."""
        for part in (wire.head(header, len(body)), body):
            rest = memoryview(part)
            while rest:
                rest = rest[os.write(self.outgoing, rest) :]

    def serve(self, header: dict[str, Any]) -> None:
        """Do what is asked."""
        session = header.get("session")
        process = self.sessions.pop(session, None) if session is not None else None
        if header["op"] == "close":
            if process is not None:
                self.forks.finish(process)
            self.send({"id": header["id"], "closed": True})
        elif process is None and session is not None and not header["opens"]:
            self.send({"id": header["id"], "gone": True})
        else:
            try:
                if process is None:
                    process = self.forks.take(header["limits"])
                else:
                    self.forks.wake_up(process)
            except OSError as error:
                self.send({"id": header["id"], "failed": f"no process could be forked: {error}"})
                return
            self.call = Call(self.forks, process, header, self.send, self.poller)
            others = confine.own_tasks() if self.forks.settings["same_user"] else 0
            told = {"limits": header["limits"], "others": others, "input": header["input"]}
            self.call.hand_over(memoryview(wire.head(told, self.body_left)))

    def finish(self, call: Call) -> None:
        """Answer a call that is over; keep its process where a session goes on."""
        self.call = None
        self.read_body()
        self.send(call.finish())
        if call.session is not None and call.process.exit is None and call.failed is None:
            self.sessions[call.session] = call.process
        else:
            self.forks.finish(call.process)


def main(settings: dict[str, Any]) -> NoReturn:
    """Start here, inside the sandbox."""
    incoming, outgoing, errors = (fcntl.fcntl(number, fcntl.F_DUPFD_CLOEXEC, 64) for number in (0, 1, 2))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, JOB):
        os.dup2(nowhere, number)
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
    forks = Forks(settings, high(os.open("/proc", os.O_RDONLY | os.O_DIRECTORY)))
    code = 1
    try:
        Keeper(forks, incoming, outgoing).main()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        code = 0  # the library is gone
    except BaseException:  # noqa: BLE001 - told on the sandbox's error output, which is no longer this process's
        os.write(errors, traceback.format_exc().encode("utf-8", "replace"))
    finally:
        forks.end()
        os._exit(code)
