"""Bringing a machine up: its folder, its sandbox, and what ends both."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gem_terminal.backends.local import launch, roots
from gem_terminal.backends.local.channel import Channel
from gem_terminal.backends.local.machine import LocalMachine, Surroundings, end_process, wait_for
from gem_terminal.errors import EngineError

if TYPE_CHECKING:
    from gem_terminal.backends.local.scratch import Scratch

_START_S = 30.0


@dataclass(frozen=True)
class Bounds:
    """What a machine may take; see ``Limits``.

    Args:
        memory_mb: Megabytes of memory.
        processes: Processes and threads.
        storage_mb: Megabytes written.
        shm_mb: Megabytes of ``/dev/shm``.
    """

    memory_mb: int
    processes: int
    storage_mb: int
    shm_mb: int = 64


class Machines:
    """The machines of this process.

    Args:
        scratch: Where their folders are.
    """

    def __init__(self, scratch: Scratch) -> None:
        self.scratch = scratch
        self._lock = threading.Lock()
        self._running: dict[str, LocalMachine] = {}

    def start(
        self,
        surroundings: Surroundings,
        bounds: Bounds,
        *,
        template: Path | None = None,
        baseline_kb: int = 0,
        keep: Sequence[Path] = (),
        hostname: str = "terminal",
    ) -> LocalMachine:
        """Start a machine.

        Args:
            surroundings: What its programs find.
            bounds: What it may take.
            template: Folder that its files are copied from; None for those of an empty root.
            baseline_kb: What those take, for what is written later.
            keep: Where its files go when it is removed, if anything stands there by then; else they are removed too.
            hostname: Its name inside.

        Raises:
            EngineError: It cannot be started; says what to do.
        """
        launch.check()
        try:
            place = self.scratch.take()
        except OSError as error:
            raise EngineError(f"no folder for a machine: {error}; name another (TMPDIR, or 'folder')") from error
        process = None
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        settings: dict[str, Any] = {"system": list(launch.system()), "limits": vars(bounds), "baseline_kb": baseline_kb}
        channel = Channel(ours, vars(bounds))
        try:
            if template is None:
                roots.make(place.folder / "root")
            process = launch.launch(place.folder, hostname, theirs, template)
            theirs.close()
            channel.start({**settings, "copy": template is not None})
            if not wait_for(process, channel, _START_S):
                lost = channel.why_lost()
                process.kill()
                process.wait()
                raise launch.cannot(launch.failure(process) or str(lost or ""))
        except BaseException as error:
            theirs.close()
            channel.end("it did not start", None)
            if process is not None:
                end_process(process)
            self.scratch.give_back(place)
            if isinstance(error, OSError):
                raise EngineError(f"the sandbox did not start: {error}") from error
            raise
        owner = os.getpid()

        def release() -> None:
            if os.getpid() != owner:
                return  # a fork of the process that it belongs to
            channel.end(f"{place.id} was removed", None)
            end_process(process)
            if keep:
                os.rename(place.folder / "root", keep[0])
            self.scratch.give_back(place)
            with self._lock:
                self._running.pop(place.id, None)

        machine = LocalMachine(place.id, channel, surroundings, release)
        with self._lock:
            self._running[place.id] = machine
        return machine

    def close(self) -> None:
        """Remove them all."""
        with self._lock:
            running = list(self._running.values())
        for machine in running:
            machine.remove()
