"""``Executor``: where the environments of slots live and run; a vector environment has one or several."""

from __future__ import annotations

import mmap
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, Protocol

from gem_core.vector.commands import Command, Failure, Outcome
from gem_core.vector.runner import EnvRunner

Launch = tuple[int, int, Command]
"""Slot, ticket, command. The ticket identifies the command, so that an outcome that comes too late is dropped."""


class Listener(Protocol):
    """Receives the outcomes that an executor reports; the scheduler of a vector environment is one."""

    def advance(self, slot: int, ticket: int, outcome: Outcome) -> None:
        """Receive the outcome of a command, from any thread; drop it if the command was abandoned."""
        ...


class Executor(ABC):
    """Where environments live and run.

    A slot has one command at a time. The table in ``docs/vector-environments.md`` lists which faults each executor
    contains; an executor that cannot enforce a ``step_timeout`` refuses it.
    """

    scheduler: Listener

    runners: Sequence[EnvRunner] = ()
    """The runner of each slot, if environments live in this process; otherwise override the methods that use them."""

    @abstractmethod
    def start(self, batch: list[Launch]) -> None:
        """Start commands; report each outcome by ``scheduler.advance``, in any order, from any thread."""

    @abstractmethod
    def close(self) -> None:
        """Close every environment, and end their threads and workers; calling it again does nothing."""

    @abstractmethod
    def renewed(self) -> Executor:
        """Return an executor with the same settings, without environments, that shares no lock with this one.

        An interrupt may have left this one in an inconsistent state; it is then closed in another thread.
        """

    def in_place(self, slot: int, command: Command) -> EnvRunner | None:
        """Return the slot's runner if the caller can run the command at once, in microseconds; otherwise None."""
        return None

    def release(self, slot: int) -> None:
        """Close a slot's environment, if there is one that is not the caller's."""
        self.runners[slot].release()

    def sample_random_action(self, slot: int, seed: int | None, agent: str | None = None) -> str:
        """Return a valid action, of one of several agents, from a generator seeded with ``seed`` in each episode."""
        return self.runners[slot].sample_random_action(seed, agent)

    def describe(self, slot: int) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` and ``wrappers`` of a slot's environment; the id is None if there is none."""
        return self.runners[slot].describe()

    def tasks(self, slot: int, env_id: str | None, kwargs: Mapping[str, Any]) -> tuple[int | None, bool]:
        """Return ``num_tasks`` and ``endless_tasks`` of an environment; make it if the slot does not have it."""
        return self.runners[slot].tasks(env_id, kwargs)

    def apply(
        self, slot: int, env_id: str | None, kwargs: Mapping[str, Any], function: Callable[..., Any], *args: Any
    ) -> Any:
        """Return ``function(env, slot, *args)`` for a slot's environment; make that of the id if there is none.

        Args:
            slot: Number of the slot, without a command under way.
            env_id: Id of the slot's own environment.
            kwargs: Keyword arguments of that environment.
            function: A function of a module, so that it can be sent to another process.
            *args: What it takes besides.
        """
        return self.runners[slot].apply(env_id, kwargs, function, *args)

    # For step_timeout.

    def running(self) -> dict[int, float]:
        """Return the slots whose command is running, and since when, by ``time.monotonic()``."""
        return {}

    def abandon(self, slot: int, failure: Failure) -> None:
        """Abandon a slot's command that takes too long, so that the slot can be used again.

        Args:
            slot: A slot that ``running`` returned.
            failure: The failure that is reported for it.

        Raises:
            FaultBudgetError: Too many commands have been abandoned.
        """
        raise NotImplementedError(f"{type(self).__name__} says what is running, and does not define abandon")


class CommandTimes:
    """Start time of each slot's running command, in memory that other processes can read even after this one died.

    Args:
        slots: Number of slots.
        file: Descriptor of an open file, which is resized as needed; None for memory of this process.
    """

    def __init__(self, slots: int, file: int | None = None) -> None:
        size = max(8, 8 * slots)
        if file is not None:
            os.ftruncate(file, size)
        self._since = memoryview(bytearray(size) if file is None else mmap.mmap(file, size)).cast("d")

    def begin(self, slot: int) -> None:
        """Record that a command begins."""
        self._since[slot] = time.monotonic()

    def end(self, slot: int) -> None:
        """Record that no command is running."""
        self._since[slot] = 0.0

    def running(self) -> dict[int, float]:
        """Return the slots whose command is running, and since when, from one copy of the memory."""
        return {slot: since for slot, since in enumerate(self._since.tolist()) if since}


def free(lock: Any) -> None:
    """Release an ``RLock`` as often as this thread holds it.

    An interrupt may occur between the last line of a ``with`` block and the release of its lock.
    """
    with suppress(RuntimeError):  # this thread does not hold it, or no longer
        while True:
            lock.release()
