"""Programs that run in a container, in a pseudo-terminal or with their output collected; and all of its processes."""

from __future__ import annotations

import contextlib
import re
import socket
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from gem_terminal.backends.docker.engine import FAILURES, Client
from gem_terminal.backends.interface import Process
from gem_terminal.errors import MachineLostError

if TYPE_CHECKING:
    import requests

    from gem_terminal.kept_output import KeptOutput

START_S = 45.0
"""Seconds in which an engine under load starts a program; one that does not start in them is held by the agent."""

_WRITE_S = 3.0
_CHUNK = 65536
_HEADER = 8
_LOOK_S = 0.05
"""Seconds of silence after which a program is first asked for its exit code: what it left running may hold its output
open."""

# The shell that turns into the program says its own number, which is the program's in the container. Errors go the way
# of the output, so that both come in the order in which they were written.
_NAMED = 'exec 2>&1; printf "%s\\n" "gem-terminal:$$"; exec "$@"'
_IF_THERE = 'command -v "$1" >/dev/null || { printf "%s\\n" "$1: not found"; exit 127; }; '
_FIRST = re.compile(rb"gem-terminal:(\d{1,10})\r?\n")


class ContainerProgram:
    """A program in a container, and the connection to it. For one reader and one writer at a time.

    Args:
        client: The client.
        container: Where it runs.
        command: Its words.
        user: Who runs it; empty for the container's user.
        workdir: Where; empty for the container's.
        env: Further variables.
        tty: Whether it gets a pseudo-terminal; else it has no input.
        before: What the shell that starts it does first.

    Raises:
        docker.errors.APIError: The engine refused.
        MachineLostError: It did not start in a long time. So it is when the agent stops the engine's own process in its
            container before that turns into the program; the engine (20.10) then only obeys when told to kill it.
    """

    def __init__(
        self,
        client: Client,
        container: str,
        command: Sequence[str],
        *,
        user: str = "",
        workdir: str = "",
        env: Mapping[str, str] | None = None,
        tty: bool = False,
        before: str = "",
    ) -> None:
        said: dict[str, Any] = {
            "Cmd": ["/bin/sh", "-c", before + (_IF_THERE if tty else "") + _NAMED, "sh", *command],
            "AttachStdin": tty,
            "AttachStdout": True,
            "AttachStderr": True,
            "Tty": tty,
            "Env": [f"{name}={value}" for name, value in (env or {}).items()],
            # By its number: the agent may have given the name another one, in the container's list of users.
            "User": "0" if user == "root" else user,
            "WorkingDir": workdir,
        }
        self._client = client
        self.exec_id = str(client.ask("POST", f"/containers/{container}/exec", json=said).json()["Id"])
        self._response = client.ask(
            "POST",
            f"/exec/{self.exec_id}/start",
            json={"Detach": False, "Tty": tty},
            headers={"Connection": "Upgrade", "Upgrade": "tcp"},
            stream=True,
        )
        self._framed = not tty
        self._ended = False
        self._left = 0
        """Bytes that are missing of the piece whose header was read."""

        self._socket, self._pending = _taken(self._response)
        self._early = b""
        self.pid: int | None = None
        self._read_pid()

    def read(self, timeout_s: float) -> bytes | None:
        """Return the next bytes; ``b""`` when time has passed, None when there will be no more."""
        if self._early:
            data, self._early = self._early, b""
            return data
        deadline = time.monotonic() + timeout_s
        while True:
            if data := self._piece():
                return data
            if self._ended:
                return None
            left = deadline - time.monotonic()
            if (left <= 0 < timeout_s) or not self._receive(max(left, 0.0)):
                return None if self._ended else b""

    def write(self, data: bytes, timeout_s: float) -> None:
        """Send bytes, for as long as the other side takes them; what was not taken in time is dropped.

        Raises:
            OSError: The connection is gone.
        """
        deadline = time.monotonic() + timeout_s
        view = memoryview(data)
        while view and (left := deadline - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                view = view[self._socket.send(view[:_CHUNK]) :]
            except TimeoutError:
                return

    def exit_code(self) -> int | None:
        """Return its exit code; None while it runs."""
        said = self._client.exec_inspect(self.exec_id)
        code = said.get("ExitCode")
        return None if said.get("Running") or code is None else int(code)

    def close(self) -> None:
        """Close the connection, by which the program does not end; may be called again."""
        self._ended = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        for closing in (self._socket, self._response):
            with contextlib.suppress(*FAILURES):
                closing.close()

    def _read_pid(self) -> None:
        deadline = time.monotonic() + START_S
        heard = b""
        while b"\n" not in heard and len(heard) < _CHUNK:
            data = self.read(max(0.01, deadline - time.monotonic()))
            if data is None:
                break
            heard += data
            if not data and time.monotonic() > deadline:
                self.close()
                raise MachineLostError("no program starts in the machine any more: one in it stops them", by_agent=True)
        match = _FIRST.match(heard)
        self.pid = int(match.group(1)) if match else None
        self._early = heard[match.end() if match else 0 :]

    def _receive(self, timeout_s: float) -> bool:
        try:
            self._socket.settimeout(timeout_s)
            data = self._socket.recv(_CHUNK)
        except (TimeoutError, BlockingIOError):
            return False
        except (OSError, ValueError):
            data = b""
        self._ended = not data
        self._pending += data
        return bool(data)

    def _piece(self) -> bytes:
        """Take what has come, without the headers that the engine puts before each piece where no terminal is."""
        if not self._framed:
            data, self._pending = self._pending, b""
            return data
        data = b""
        while self._pending and (self._left or len(self._pending) >= _HEADER):
            if not self._left:
                self._left = int.from_bytes(self._pending[4:_HEADER], "big")
                self._pending = self._pending[_HEADER:]
            piece, self._pending = self._pending[: self._left], self._pending[self._left :]
            self._left -= len(piece)
            data += piece
        return data


def _taken(response: requests.Response) -> tuple[Any, bytes]:
    """Return the socket below a response, and what was read of it together with the headers.

    The engine may send a program's first words in one piece with its own: docker's client would lose them
    (docker 7.2, ``_get_raw_response_socket``).
    """
    below: Any = cast("Any", response.raw)._fp.fp
    connection = getattr(below, "channel", None)  # as over SSH
    if connection is not None:
        return connection, b""
    connection = below.raw._sock
    connection.settimeout(0)
    try:
        early = below.peek()
    except OSError:
        early = b""
    return connection, bytes(early)


class DockerTerminal:
    """A program in a pseudo-terminal of a container; see ``Terminal``.

    Args:
        program: The program.
        lost: What happened to the machine; None while it is there.
        hang_up: Takes the number of the program, which is to get a hang-up: the engine sends none.
    """

    def __init__(
        self, program: ContainerProgram, lost: Callable[[], MachineLostError | None], hang_up: Callable[[int], object]
    ) -> None:
        self._program, self._lost, self._hang_up = program, lost, hang_up
        self.pid = program.pid or 0
        self._closed = False

    def read(self, timeout_s: float) -> bytes:
        """Return what the program wrote, as soon as there is something; ``b""`` when ``timeout_s`` has passed."""
        heard = self._program.read(timeout_s)
        if heard is None:
            raise self._end()
        return heard

    def write(self, data: bytes) -> None:
        """Type; what is not taken within a few seconds is dropped."""
        try:
            self._program.write(data, _WRITE_S)
        except (OSError, ValueError) as error:
            raise self._end() from error

    def close(self) -> None:
        """Close it; the program gets a hang-up."""
        if not self._closed:
            self._closed = True
            self._program.close()
            self._hang_up(self.pid)

    def _end(self) -> MachineLostError:
        return self._lost() or MachineLostError("the program in the terminal has ended", by_agent=True)


def follow(program: ContainerProgram, output: KeptOutput, timeout_s: float) -> int | None:
    """Collect output until the command itself has ended; return its exit code, None when time runs out before."""
    deadline = time.monotonic() + timeout_s
    pause, is_open = _LOOK_S, True
    while (left := deadline - time.monotonic()) > 0:
        data = program.read(min(left, pause)) if is_open else b""
        if data:
            output.add(data)
            pause = _LOOK_S
            continue
        if data is None:
            pause, is_open = 0.0, False
        if (code := program.exit_code()) is not None:
            # Take what was on its way when the command ended; what it left running may go on writing.
            deadline = time.monotonic() + 1.0
            while (data := program.read(0.02)) and time.monotonic() < deadline:
                output.add(data)
            return code
        pause = min(2 * pause + 0.002, 1.0)
        if not is_open:
            time.sleep(min(left, pause))
    return None


# The processes of a container. The engine's own list (``docker top``) counts as its host does, and can end nothing; so
# a program of the container looks and kills, as root. The shell does so without starting another, for an agent may have
# used up the processes that there may be. Nothing of this withstands an agent that has replaced ``/bin/sh`` or
# ``grep``: the container's removal does.

LIST = ["/bin/sh", "-c", 'exec grep -as "" /proc/[0-9]*/stat /proc/[0-9]*/cmdline']

_KILL = r"""
found=
for one; do
  stat=
  while IFS= read -r line || [ -n "$line" ]; do stat="$stat $line"; done 2>/dev/null <"/proc/${one%:*}/stat" || continue
  set -- ${stat##*) }
  [ "${20}" = "${one#*:}" ] && found="$found ${one%:*}"
done
$stop $found 2>/dev/null
kill -KILL $found 2>/dev/null
:
"""
_MANY = 12
"""So many are all stopped before the first is killed: else, where processes multiply, a new one takes the place of each
that ends. A shell shows one that was stopped as a job of its own, hence not always."""

_ROW = re.compile(r"/proc/(\d+)/(stat|cmdline):(.*)")
_KEEPERS_SESSION = 1
_COMMAND = 200


def read_list(output: bytes, own: int | None) -> list[Process]:
    """Return the processes that :data:`LIST` has found, without what keeps the container.

    Args:
        output: What it wrote.
        own: Its own number.
    """
    texts: dict[tuple[int, str], str] = {}
    for line in output.replace(b"\0", b" ").decode("utf-8", "replace").split("\n"):
        if row := _ROW.match(line):
            key = int(row.group(1)), row.group(2)
            texts[key] = f"{texts[key]}\n{row.group(3)}" if key in texts else row.group(3)
    found = []
    for (pid, what), text in texts.items():
        name, _, rest = text.rpartition(") ")
        fields = rest.split()
        if what != "stat" or len(fields) < 20 or fields[0] in "ZX" or pid == own:
            continue
        words = texts.get((pid, "cmdline"), "").strip() or f"[{name.partition('(')[2]}]"
        process = Process(pid, int(fields[1]), int(fields[19]), words[:_COMMAND], int(fields[3]))
        # The first process begins a session; what the engine starts, and with it what the agent does, has others.
        if process.session != _KEEPERS_SESSION:
            found.append(process)
    return found


def kill_command(processes: Iterable[Process]) -> list[str]:
    """Return a command that kills processes, but those whose numbers are others' by now."""
    words = [f"{one.pid}:{one.started}" for one in processes]
    stop = "kill -STOP" if len(words) >= _MANY else ":"
    return ["/bin/sh", "-c", f"stop='{stop}'{_KILL}", "sh", *words]


def came_from(processes: Iterable[Process], pid: int, started: int) -> list[Process]:
    """Return a command's process, those below it, and orphans that are younger than the command.

    Args:
        processes: All that there are.
        pid: The command's number.
        started: When it was started; it may have ended.
    """
    by_number = {process.pid: process for process in processes}

    def is_of_it(process: Process) -> bool:
        seen: set[int] = set()
        while process.pid != pid and process.parent in by_number and process.pid not in seen:
            seen.add(process.pid)
            process = by_number[process.parent]
        return process.pid == pid or (process.parent == 1 and process.started >= started)

    return [process for process in by_number.values() if is_of_it(process)]
