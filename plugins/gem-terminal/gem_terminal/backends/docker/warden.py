r"""``Warden``: what sees and ends the processes of a machine, out of the agent's reach.

The agent may be root in its container, and may have replaced ``ps``, ``kill`` and the shell there. So the warden is a
container of its own, of the task's image as nothing has touched it, without network, that shares the agent's process
numbers and nothing else; the program in it takes orders on its input. It is started when it is first needed, which
takes as long as any container, and answers in milliseconds from then on. It may look into all processes, and has more
capabilities than any of them, so that none can look into it. Being root they can kill it; then it is started again
while the agent's container is frozen. (The engine's own ``top`` counts processes as its host does, which helps to see
that there are none but not to name or end one.)
"""

from __future__ import annotations

import contextlib
import re
import secrets
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import docker.errors

from gem_terminal.backends.docker.engine import FAILURES
from gem_terminal.backends.docker.labels import labels
from gem_terminal.backends.docker.stream import Stream
from gem_terminal.backends.interface import Process
from gem_terminal.errors import EngineError

if TYPE_CHECKING:
    from gem_terminal.backends.docker.engine import Engine
    from gem_terminal.backends.docker.things import Things

_ANSWER_S = 30.0
_FIRST_WORD_S = 3.0
"""Seconds until it says that it has heard; one that does not in them is taken for stopped, and started again."""
_MOST_ANSWER = 16_000_000
_COMMAND = 200
_FREEZES = 30
_PROGRAM = r"""
while read -r order rest; do
  printf '\n'
  if [ "$order" = list ]; then
    printf '\n%s places\n' "$N"
    stat -L -c '%n %i' /proc/[0-9]*/ns/mnt 2>/dev/null
    for p in /proc/[0-9]*; do
      printf '\n%s process\n' "$N"
      head -q -c 1000 "$p/stat" "$p/cmdline" 2>/dev/null
    done
  else
    for p in $rest; do kill -9 "$p" 2>/dev/null; done
  fi
  printf '\n%s end %s\n' "$N" $$
done
"""
# The name, which a process chooses, may have any byte in it; the numbers that follow say where it ends.
_STAT = re.compile(rb"(\d+) \(.{0,64}?\) [A-Za-z] (-?\d+ ){18}(\d+)( -?\d+){10,}\n", re.DOTALL)


@dataclass(frozen=True)
class Seen:
    """A process as the warden sees it.

    Args:
        process: The process.
        place: The mount namespace it is in, which says in which container; empty where that is unknown.
        is_zombie: Whether it has ended already.
    """

    process: Process
    place: str
    is_zombie: bool


class Warden:
    """Sees the processes that share a container's process numbers.

    Args:
        engine: The engine.
        things: Where its container is noted, for removal.
        image: An image that the agent has not touched.
        target: Name of the container whose process numbers are shared.
    """

    def __init__(self, engine: Engine, things: Things, image: str, target: str) -> None:
        self._engine = engine
        self._things = things
        self._image = image
        self._target = target
        self._lock = threading.Lock()
        self._stream: Stream | None = None
        self._nonce = ""
        self._name = ""

    @property
    def is_up(self) -> bool:
        """Whether it has been started."""
        return self._stream is not None

    def processes(self) -> list[Seen]:
        """Return all processes there are, but its own."""
        with self._lock:
            answer, own = self._ask("list")
        return _read(answer, own)

    def kill(self, pids: Sequence[int]) -> None:
        """Kill processes."""
        if pids:
            with self._lock:
                self._ask(f"kill {' '.join(map(str, pids))}")

    def close(self) -> None:
        """Let go of it; its container ends by that."""
        with self._lock:
            self._drop()

    def _ask(self, order: str) -> tuple[list[bytes], int]:
        if self._stream is not None:
            with contextlib.suppress(EngineError):
                return self._answer(order, _FIRST_WORD_S)
        # It is not there, or not any more: killed or stopped by the agent, who can do nothing for as long as it is
        # frozen. Podman 4.3 starts nothing beside a container that is stopped so.
        with contextlib.nullcontext() if self._engine.is_podman else frozen(self._engine, self._target):
            self._start()
            return self._answer(order)

    def _answer(self, order: str, first_word_s: float = _ANSWER_S) -> tuple[list[bytes], int]:
        deadline = time.monotonic() + first_word_s
        heard = bytearray()
        mark = f"\n{self._nonce} ".encode()
        stream = self._stream
        if stream is None:
            raise EngineError("the warden of a machine is gone")
        try:
            stream.write(order.encode() + b"\n", _ANSWER_S)
            while True:
                data = stream.read(deadline - time.monotonic()) if time.monotonic() < deadline else None
                if data is None or len(heard) > _MOST_ANSWER:
                    break
                if data and not heard:
                    deadline = time.monotonic() + _ANSWER_S
                heard += data
                at = heard.rfind(mark + b"end ", max(0, len(heard) - len(data) - 200))
                if at >= 0 and heard.endswith(b"\n"):
                    return bytes(heard[:at]).split(mark)[1:], int(heard[at + len(mark) + 4 :])
        except (OSError, ValueError) as error:
            self._drop()
            raise EngineError(f"the warden of a machine is gone ({error})") from error
        self._drop()
        raise EngineError("the warden of a machine does not answer")

    def _start(self) -> None:
        self._drop()
        self._nonce = secrets.token_hex(16)
        self._name = f"gem-terminal-{secrets.token_hex(8)}"
        self._things.containers.append(self._name)
        said = {
            "Image": self._image,
            "Labels": labels("warden"),
            "Entrypoint": ["/bin/sh", "-c", _PROGRAM],
            "Cmd": [],
            "Env": [f"N={self._nonce}"],
            "User": "0:0",
            "WorkingDir": "/",
            "OpenStdin": True,
            "StdinOnce": True,
            "AttachStdin": True,
            "AttachStdout": True,
            "Healthcheck": {"Test": ["NONE"]},
            "HostConfig": {
                "NetworkMode": "none",
                "PidMode": f"container:{self._target}",
                "CapDrop": ["ALL"],
                "CapAdd": ["KILL", "SYS_PTRACE"],
                "SecurityOpt": ["no-new-privileges"],
                "ReadonlyRootfs": True,
                "LogConfig": {"Type": "none"},
                "Memory": 64 * 2**20,
                "PidsLimit": 64,
            },
        }
        with self._engine.asking("start the warden of a machine") as client:
            client.make_container(said, self._name)
            params = {"stdin": 1, "stdout": 1, "stream": 1}
            self._stream = Stream(client, f"/containers/{self._name}/attach", framed=True, params=params)
            client.start(self._name)

    def _drop(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None
        if self._name:
            self._things.remove_containers([self._name])
            self._name = ""


@contextlib.contextmanager
def frozen(engine: Engine, name: str) -> Iterator[None]:
    """Stop all processes of a container for a moment, so that nothing changes in between.

    An engine that cannot do this goes without: then what is done inside may miss what came up meanwhile.
    """
    is_frozen, most = False, None
    try:
        try:
            engine.client.pause(name)
            is_frozen = True
        except docker.errors.APIError as error:
            if "unable to freeze" in str(error):
                most = _processes_of(engine, name)
                is_frozen = _freeze_bomb(engine, name)
        yield
    finally:
        if most is not None:
            _allow(engine, name, most)
        if is_frozen:
            with contextlib.suppress(*FAILURES):
                engine.client.unpause(name)


def _freeze_bomb(engine: Engine, name: str) -> bool:
    """Stop a container whose processes multiply too fast for the kernel to stop them all: first that ends."""
    _allow(engine, name, 1)
    for _ in range(_FREEZES):
        try:
            engine.client.pause(name)
        except docker.errors.APIError as error:
            if "unable to freeze" not in str(error):
                return False
        else:
            return True
    return False


def _processes_of(engine: Engine, name: str) -> int | None:
    """Return how many processes a container may have; None where there is no limit."""
    limit = engine.client.inspect_container(name)["HostConfig"].get("PidsLimit")
    return int(limit) if limit and limit > 0 else None


def _allow(engine: Engine, name: str, processes: int) -> None:
    """Change how many processes a container may have; an engine that cannot do this goes without."""
    with contextlib.suppress(*FAILURES):
        engine.client.ask("POST", f"/containers/{name}/update", json={"PidsLimit": processes})


def _read(pieces: list[bytes], own: int) -> list[Seen]:
    places: dict[int, str] = {}
    found: list[Seen] = []
    for piece in pieces:
        kind, _, text = piece.partition(b"\n")
        if kind == b"places":
            for line in text.decode("ascii", "replace").splitlines():
                path, _, number = line.partition(" ")
                whose = path.split("/")[2] if path.startswith("/proc/") else ""
                if whose.isdecimal():
                    places[int(whose)] = number
            continue
        match = _STAT.match(text)
        if match is None:
            continue
        fields = match.group().rpartition(b")")[2].split()
        words = text[match.end() :].replace(b"\0", b" ").strip().decode("utf-8", "replace")
        name = match.group().partition(b"(")[2].rpartition(b")")[0].decode("utf-8", "replace")
        pid, parent = int(match.group(1)), int(fields[1])
        if pid == own or parent == own:
            continue
        process = Process(pid, parent, int(fields[19]), (words or f"[{name}]")[:_COMMAND], int(fields[3]))
        found.append(Seen(process, places.get(pid, ""), fields[0] in (b"Z", b"X")))
    return found
