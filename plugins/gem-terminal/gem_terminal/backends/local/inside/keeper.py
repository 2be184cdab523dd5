"""The first process of a sandbox: it starts programs for the library, watches what they take, and ends with it.

It never runs what the agent wrote. It reads what is asked from a socket that it has inherited; when that closes, or the
library's process ends, it ends, and the kernel ends all other processes with it.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import select
import signal
import socket
import time
from collections.abc import Callable
from typing import Any, NamedTuple, NoReturn

from gem_terminal.backends.local.inside import compare, files, kernel, processes, programs, views, wire

_TICK_S = 0.25
_SIZES_S = 2.0
_SIZES_IDLE_S = 5.0
_COPY_S = 120.0
_AGENT = "root"
_PAGE = os.sysconf("SC_PAGE_SIZE")


class Helper(NamedTuple):
    """A program of ours that works while the keeper goes on.

    Args:
        output: File descriptor of what it says.
        then: Called with that when it has ended; it is closed afterwards.
        until: When it is killed.
    """

    output: int
    then: Callable[[int], None]
    until: float


class Keeper:
    """Serves one machine.

    Args:
        channel: Where the library asks.
        owner: File descriptor of the library's process.
        settings: ``system``, the paths that are shown read-only; ``limits``; ``baseline_kb``.
    """

    def __init__(self, channel: socket.socket, owner: int, settings: dict[str, Any]) -> None:
        self.channel, self.owner, self.settings = channel, owner, settings
        self.limits = settings["limits"]
        self.trash = files.Trash(f"{views.SCRATCH}/trash")
        self.views: dict[str, views.View] = {}
        self.minders: dict[int, tuple[int, str]] = {}
        self.infrastructure: set[int] = set()
        self.waited: dict[int, int] = {}
        self.helpers: dict[int, Helper] = {}
        self.sizes_due = time.monotonic() + _SIZES_S
        self.measured = time.monotonic()
        self.measuring = False
        self.ticks = 0.0
        self.watched = 0.0
        self.quiet = False
        self.copied_ns = 0
        self.woken, waker = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(waker, warn_on_full_buffer=False)

    def main(self) -> None:
        """Serve until the library is gone."""
        views.fence_kernel()
        if self.settings["copy"]:
            self.copy_template()
        self.open_view(_AGENT, kernel.AGENT_CAPABILITIES)
        wire.send(self.channel, {"op": "ready"})
        poller = select.poll()
        for descriptor in (self.channel.fileno(), self.owner, self.woken):
            poller.register(descriptor, select.POLLIN)
        while True:
            for descriptor, _ in poller.poll(None if self.quiet else int(_TICK_S * 1000)):
                self.quiet = False
                if descriptor == self.owner:
                    quit_now()
                elif descriptor == self.woken:
                    with contextlib.suppress(BlockingIOError):
                        os.read(self.woken, 4096)
                else:
                    self.serve()
            self.reap()
            self.watch()

    def copy_template(self) -> None:
        """Copy the files that the machine starts with; in here, root may read them whatever their permissions."""
        pid, told = programs.helper(["cp", "-a", "/template/.", f"{views.SCRATCH}/{_AGENT}"])
        _, status = os.waitpid(pid, 0)
        os.close(told)
        if status:
            raise OSError(f"the template could not be copied (cp ended with {programs.exit_code(status)})")
        marker = os.open(f"{views.SCRATCH}/copied", os.O_CREAT | os.O_WRONLY | os.O_CLOEXEC, 0o600)
        self.copied_ns = os.fstat(marker).st_ctime_ns
        os.close(marker)

    def open_view(self, name: str, capabilities: tuple[int, ...]) -> None:
        """Make a view of a folder."""
        shm_mb = self.limits["shm_mb"]
        self.views[name] = views.make(name, self.settings["system"], shm_mb, capabilities)

    def serve(self) -> None:
        """Do one thing that is asked, and answer."""
        try:
            received = wire.receive(self.channel)
        except OSError:
            received = None
        if received is None:
            quit_now()
        message, descriptors = received
        answer: dict[str, Any] | None
        made: list[int] = []
        try:
            answer = getattr(self, f"do_{message['op']}")(message, descriptors, made)
        except (OSError, ValueError) as error:
            answer = failed(error)
        except KeyError as error:
            answer = {"error": f"there is no view {error} (any more)", "full": False}
        finally:
            for descriptor in descriptors:
                os.close(descriptor)
        if answer is not None:
            self.answer(message["id"], answer, tuple(made))
        for descriptor in made:
            os.close(descriptor)

    def answer(self, identifier: int, message: dict[str, Any], descriptors: tuple[int, ...] = ()) -> None:
        """Answer what was asked under a number."""
        try:
            wire.send(self.channel, {"id": identifier, **message}, descriptors)
        except OSError:
            quit_now()

    def bounds(self, view: str) -> list[tuple[int, int]]:
        """Return the limits of a program in a view."""
        return programs.limits(self.limits, judge=view != _AGENT)

    def do_run(self, message: dict[str, Any], descriptors: list[int], _: list[int]) -> dict[str, Any]:
        """Run a program; its output goes to the first descriptor, its exit code to the second."""
        output, done = descriptors
        view = self.views[message["view"]]
        pid = programs.mind(message, view, self.bounds(message["view"]), output, done)
        self.minders[message["id"]] = (pid, message["view"])
        self.infrastructure.add(pid)
        return {"pid": pid}

    def do_main(self, message: dict[str, Any], descriptors: list[int], _: list[int]) -> dict[str, Any]:
        """Start a program that belongs to the machine, not to the agent."""
        view = self.views[message["view"]]
        pid = programs.start(message, view, self.bounds(message["view"]), descriptors[0], -1)
        self.infrastructure.add(pid)
        return {"pid": pid}

    def do_end(self, message: dict[str, Any], _: list[int], __: list[int]) -> dict[str, Any]:
        """End a program that was run, and all that came from it."""
        self.end_run(message["run"])
        return {}

    def end_run(self, number: int) -> None:
        """Kill all that is below a minder, and the minder."""
        if number in self.minders:
            minder = self.minders[number][0]
            processes.stop(minder)
            processes.kill_all(lambda: processes.below(minder))
            with contextlib.suppress(OSError):
                os.kill(minder, signal.SIGKILL)

    def do_terminal(self, message: dict[str, Any], _: list[int], made: list[int]) -> dict[str, Any]:
        """Start a program in a terminal; answer with its controlling end, and a pipe that closes with the program."""
        ours, theirs = os.openpty()
        told, tell = os.pipe2(os.O_CLOEXEC)
        ended, ends = os.pipe2(os.O_CLOEXEC)
        made += [ours, ended]
        try:
            programs.window(theirs, message["columns"], message["lines"])
            view = self.views[message["view"]]
            pid = programs.start(message, view, self.bounds(message["view"]), theirs, tell)
        except BaseException:
            os.close(told)
            os.close(ends)
            raise
        finally:
            os.close(theirs)
            os.close(tell)
        self.waited[pid] = ends
        words = os.read(told, 4096)
        os.close(told)
        if words:
            return {"error": words.decode("utf-8", "replace").strip(), "full": False}
        return {"pid": pid}

    def do_write(self, message: dict[str, Any], descriptors: list[int], _: list[int]) -> dict[str, Any]:
        """Write files and folders."""
        root = self.views[message["view"]].folder
        sources = iter(descriptors)
        for entry in message["entries"]:
            files.write(root, self.trash, entry, next(sources) if entry["kind"] == "file" else None)
        self.empty_trash()
        return {}

    def do_remove(self, message: dict[str, Any], _: list[int], __: list[int]) -> dict[str, Any]:
        """Remove files and folders."""
        for path in message["paths"]:
            files.remove(self.views[message["view"]].folder, self.trash, path)
        self.empty_trash()
        return {}

    def do_read(self, message: dict[str, Any], _: list[int], made: list[int]) -> dict[str, Any]:
        """Answer with the files at a path, in a file in memory."""
        made.append(wire.in_memory(b""))
        root = self.views[message["view"]].folder
        return {"index": files.collect(root, message["path"], message["most_bytes"], made[0])}

    def do_processes(self, message: dict[str, Any], _: list[int], __: list[int]) -> dict[str, Any]:
        """Answer with the processes of a view."""
        found = processes.in_view(self.views[message["view"]].identity)
        rows = [
            [stat.pid, stat.parent, stat.started, processes.command_line(stat.pid), stat.session]
            for stat in found
            if stat.pid not in self.infrastructure
        ]
        return {"processes": rows}

    def do_kill(self, message: dict[str, Any], _: list[int], __: list[int]) -> dict[str, Any]:
        """Kill processes."""
        for pid, started in message["processes"]:
            if pid != os.getpid():
                processes.kill(pid, started)
        return {}

    def do_judge(self, message: dict[str, Any], _: list[int], __: list[int]) -> None:
        """Copy the agent's files, and open a view of the copy."""
        name = message["name"]

        def then(_: int) -> None:
            try:
                self.open_view(name, kernel.JUDGE_CAPABILITIES)
            except OSError as error:
                self.answer(message["id"], {"error": str(error), "full": error.errno == errno.ENOSPC})
            else:
                self.answer(message["id"], {})

        # What changes while it is copied makes it complain; whether there is a copy is seen when it is opened.
        words = ["cp", "-a", f"{self.views[_AGENT].folder}/.", f"{views.SCRATCH}/{name}"]
        os.makedirs(f"{views.SCRATCH}/{name}", mode=0o755)
        self.help(words, then, _COPY_S)

    def do_dismiss(self, message: dict[str, Any], _: list[int], __: list[int]) -> dict[str, Any]:
        """End a judge's view."""
        view = self.views.pop(message["view"], None)
        if view is not None:
            for number in [number for number, (_, of) in self.minders.items() if of == message["view"]]:
                self.end_run(number)
            processes.kill_all(lambda: processes.in_view(view.identity))
            os.close(view.descriptor)
            os.rename(view.folder, f"{self.trash.folder}/{message['view'].replace('/', '-')}")
            self.empty_trash()
        return {}

    def do_changed(self, message: dict[str, Any], _: list[int], __: list[int]) -> dict[str, Any] | None:
        """Answer with how a view differs from the template."""
        if not self.settings["copy"]:
            return {"changed": None}
        root = self.views[message["view"]].folder
        since = self.copied_ns if message["view"] == _AGENT else 0
        self.work(message["id"], lambda: {"changed": compare.Comparison(since).run(root)})
        return None

    def do_put_back(self, message: dict[str, Any], _: list[int], __: list[int]) -> dict[str, Any] | None:
        """Make paths what the template has there."""
        if not self.settings["copy"]:
            return {"paths": []}
        root = self.views[message["view"]].folder
        self.work(message["id"], lambda: {"paths": compare.put_back(root, self.trash, message["paths"])})
        return None

    def work(self, identifier: int, function: Callable[[], dict[str, Any]]) -> None:
        """Do in a process of its own what may take long, and answer then."""
        memory = wire.in_memory(b"")
        pid = os.fork()
        if pid == 0:
            try:
                try:
                    answer = function()
                except Exception as error:  # noqa: BLE001 - whatever it is, it must be answered, and not in here
                    answer = failed(error)
                with open(memory, "wb", closefd=False) as file:
                    file.write(json.dumps(answer).encode("ascii"))
            finally:
                os._exit(0)

        def then(told: int) -> None:
            os.lseek(told, 0, os.SEEK_SET)
            with open(told, "rb", closefd=False) as file:
                data = file.read()
            self.answer(identifier, json.loads(data) if data else {"error": "it took too long", "full": True})
            self.empty_trash()

        self.helpers[pid] = Helper(memory, then, time.monotonic() + _COPY_S)
        self.infrastructure.add(pid)

    def do_sizes(self, message: dict[str, Any], _: list[int], __: list[int]) -> None:
        """Answer with the kilobytes that the agent's files have grown by."""
        words = ["du", "-skx", self.views[_AGENT].folder]
        self.help(words, lambda told: self.answer(message["id"], {"grown_kb": self.grown(told)}), _COPY_S)

    def help(self, words: list[str], then: Callable[[int], None], limit_s: float) -> None:
        """Start a program of ours."""
        pid, output = programs.helper(words)
        self.helpers[pid] = Helper(output, then, time.monotonic() + limit_s)
        self.infrastructure.add(pid)

    def empty_trash(self) -> None:
        """Remove what was thrown away, in a process of its own."""
        names = os.listdir(self.trash.folder)
        if names:
            words = ["rm", "-rf", "--", *(f"{self.trash.folder}/{name}" for name in names)]
            self.help(words, lambda _: None, _COPY_S)

    def reap(self) -> None:
        """Take note of all processes that have ended."""
        while True:
            try:
                pid, _ = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if not pid:
                return
            self.infrastructure.discard(pid)
            if pid in self.waited:
                os.close(self.waited.pop(pid))
            helper = self.helpers.pop(pid, None)
            if helper is not None:
                helper.then(helper.output)
                os.close(helper.output)
            for number in [number for number, (minder, _) in self.minders.items() if minder == pid]:
                del self.minders[number]

    def watch(self) -> None:
        """See to it that the agent's programs take no more than they may."""
        now = time.monotonic()
        for pid, helper in self.helpers.items():
            if now > helper.until:
                with contextlib.suppress(OSError):
                    os.kill(pid, signal.SIGKILL)
        if now < self.watched + _TICK_S:
            return
        self.watched = now
        theirs = [stat for stat in processes.everyone() if stat.pid not in self.infrastructure and stat.pid != 1]
        # What has just been forked may not have come so far as to be one of theirs.
        self.quiet = not (theirs or self.infrastructure or self.waited)
        self.watch_memory([stat.pid for stat in theirs])
        if now > self.sizes_due and not self.measuring:
            # Most machines wait for a model most of the time. Whoever takes less than a tick can write nevertheless, as
            # with fallocate: so it is looked for then too, if less often.
            ticks = sum(stat.ticks for stat in theirs) + sum(os.times()[2:4])
            if ticks != self.ticks or now > self.measured + _SIZES_IDLE_S:
                self.ticks = ticks
                self.measure(now)

    def measure(self, now: float) -> None:
        """Find out how much the agent has written, and end the machine where it is too much."""
        self.measuring, self.measured = True, now

        def then(told: int) -> None:
            self.measuring = False
            self.ticks += sum(os.times()[2:4]) - before  # what this took is not the agent's
            self.sizes_due = time.monotonic() + max(_SIZES_S, 10 * (time.monotonic() - now))
            if self.grown(told) > self.limits["storage_mb"] * 1024:
                self.lose("storage")

        before = sum(os.times()[2:4])
        self.help(["du", "-skx", f"{views.SCRATCH}/{_AGENT}"], then, _COPY_S)

    def grown(self, told: int) -> int:
        """Return by how many kilobytes files have grown, of what ``du`` says."""
        words = os.read(told, 4096).split()
        return max(0, int(words[0]) - int(self.settings["baseline_kb"])) if words else 0

    def watch_memory(self, pids: list[int]) -> None:
        """Kill the largest process while all together have more than they may, as the kernel would."""
        sizes: list[tuple[int, int]] = []
        for pid in pids:
            with contextlib.suppress(OSError, IndexError, ValueError), open(f"/proc/{pid}/statm", "rb") as file:
                words = file.read().split()
                sizes.append(((int(words[1]) - int(words[2])) * _PAGE, pid))
        if sum(size for size, _ in sizes) > self.limits["memory_mb"] << 20:
            with contextlib.suppress(OSError):
                os.kill(max(sizes)[1], signal.SIGKILL)

    def lose(self, why: str) -> NoReturn:
        """Say why the machine ends, and end it."""
        with contextlib.suppress(OSError):
            wire.send(self.channel, {"op": "lost", "why": why})
        quit_now()


def failed(error: Exception) -> dict[str, Any]:
    """Return the answer to what failed: ``full`` says that it is the files of the agent that made it fail."""
    full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
    return {"error": f"{type(error).__name__}: {error}", "full": full or isinstance(error, compare.TooMuch)}


def quit_now() -> NoReturn:
    """End this process, and with it all others in here."""
    os._exit(0)


def main(channel: int, owner: int) -> None:
    """Start here, inside the sandbox.

    Args:
        channel: File descriptor of the socket; settings come first.
        owner: File descriptor of the library's process.
    """
    kernel.prctl(kernel.PR_SET_PDEATHSIG, signal.SIGKILL)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    link = socket.socket(fileno=channel)
    received = wire.receive(link)
    if received is None:
        quit_now()
    try:
        Keeper(link, owner, received[0]).main()
    except Exception as error:  # noqa: BLE001 - whatever it is, the library must hear why there is no machine
        with contextlib.suppress(OSError):
            wire.send(link, {"op": "lost", "why": f"{type(error).__name__}: {error}"})
    finally:
        os._exit(1)
