"""A backend in memory: machines that are objects, for tests of what is written on the interface alone."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gem_terminal.backends.interface import Resources
from gem_terminal.tasks.task import Container, Environment, Step, Task, Verifier

if TYPE_CHECKING:
    from gem_terminal.backends.interface import Limits
    from gem_terminal.errors import MachineLostError

_number = itertools.count(1)


class MemoryMachine:
    """A machine that knows whether it was removed."""

    def __init__(self, backend: MemoryBackend, task: Task) -> None:
        self.id = f"memory-{next(_number)}"
        self.backend, self.task = backend, task
        self.lost: MachineLostError | None = None
        self.removed = 0

    def why_lost(self) -> MachineLostError | None:
        """Return what a test has put there."""
        return self.lost

    def remove(self) -> None:
        """Note it."""
        self.removed += 1
        with self.backend.lock:
            self.backend.live.pop(self.id, None)


class MemoryBackend:
    """Starts machines at once, or as ``on_start`` says."""

    name = "memory"

    def __init__(self, on_start: Callable[[Task], None] | None = None) -> None:
        self.on_start = on_start
        self.lock = threading.Lock()
        self.live: dict[str, MemoryMachine] = {}
        self.made: list[MemoryMachine] = []

    def resources(self) -> Resources:
        """Return a small computer."""
        return Resources(2.0, 8192)

    def check(self, task: Task) -> None:
        """Take any task."""

    def start(self, task: Task, limits: Limits, *, environment: Any = None) -> MemoryMachine:
        """Make a machine."""
        if self.on_start is not None:
            self.on_start(task)
        machine = MemoryMachine(self, task)
        with self.lock:
            self.live[machine.id] = machine
            self.made.append(machine)
        return machine


def plain_task(name: str = "one", digest: str | None = None) -> Task:
    """Return a task of one step that asks for nothing special."""
    verifier = Verifier({}, ("true",), 10.0, "output")
    return Task(
        name=name,
        folder=Path("/nowhere") / name,
        format="harbor",
        environment=Environment(Container()),
        steps=(Step("", f"Do {name}.", verifier),),
        digest=digest or f"digest-{name}",
    )
