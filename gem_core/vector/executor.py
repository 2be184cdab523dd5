"""``Executor``: where the environments of slots live and run; a vector environment has one or several."""

from __future__ import annotations

import mmap
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Protocol

from gem_core.vector.commands import Command, Failure, Outcome
from gem_core.vector.runner import EnvRunner

Launch = tuple[int, int, Command]
"""Slot, ticket, command. The ticket tells an outcome that is waited for from one that comes too late."""


class Listener(Protocol):
    """Takes what an executor reports; the scheduler of a vector environment is one."""

    def advance(self, slot: int, ticket: int, outcome: Outcome) -> None:
        """Take the outcome of a command, from any thread; one that nobody waits for any more is dropped."""
        ...


class Executor(ABC):
    """Where environments live and run.

    A slot's commands come one at a time. Which faults an executor contains stands in the table of
    ``docs/vector-environments.md``; one that cannot keep a ``step_timeout`` refuses it.
    """

    scheduler: Listener

    runners: Sequence[EnvRunner] = ()
    """The environment of each slot, where they live in this process; else override what uses them."""

    @abstractmethod
    def start(self, batch: list[Launch]) -> None:
        """Begin to do commands; each is answered by ``scheduler.advance``, in any order, from any thread."""

    @abstractmethod
    def close(self) -> None:
        """Close every environment, and end what runs them; calling it again does nothing."""

    @abstractmethod
    def renewed(self) -> Executor:
        """Return an executor like this one, without environments, and share no lock with it.

        An interrupt may have left this one in the middle of something; it is closed, in another thread.
        """

    def in_place(self, slot: int, command: Command) -> EnvRunner | None:
        """Return the slot's runner where the command takes but microseconds and can be done by the caller at once."""
        return None

    def release(self, slot: int) -> None:
        """Close a slot's environment, if there is one that is not the caller's."""
        self.runners[slot].release()

    def sample_random_action(self, slot: int, seed: int | None) -> str:
        """Return a valid action, from a generator that starts at ``seed`` in each episode."""
        return self.runners[slot].sample_random_action(seed)

    def describe(self, slot: int) -> dict[str, Any]:
        """Return ``id``, ``kwargs`` and ``wrappers`` of a slot's environment; the id is None if there is none."""
        return self.runners[slot].describe()

    def tasks(self, slot: int, env_id: str | None, kwargs: Mapping[str, Any]) -> tuple[int | None, bool]:
        """Return ``num_tasks`` and ``endless_tasks`` of an environment, which is made if it is not there."""
        return self.runners[slot].tasks(env_id, kwargs)

    # For step_timeout.

    def running(self) -> dict[int, float]:
        """Return the slots whose command runs at this moment, and since when, by ``time.monotonic()``."""
        return {}

    def abandon(self, slot: int, failure: Failure) -> None:
        """Abandon the command of a slot, which takes too long, so that the slot can be used again.

        Args:
            slot: One of those that ``running`` returns.
            failure: What is reported of it.

        Raises:
            FaultBudgetError: Too much has been abandoned.
        """
        raise NotImplementedError(f"{type(self).__name__} says what is running, and does not define abandon")


class CommandTimes:
    """Since when the command of each slot runs, in memory that other processes can see, also when this one is dead.

    Args:
        slots: Number of slots.
        file: Number of an open file, which is given the size that it needs; None for memory of this process.
    """

    def __init__(self, slots: int, file: int | None = None) -> None:
        size = max(8, 8 * slots)
        if file is not None:
            os.ftruncate(file, size)
        self._since = memoryview(bytearray(size) if file is None else mmap.mmap(file, size)).cast("d")

    def begin(self, slot: int) -> None:
        """Note that a command begins."""
        self._since[slot] = time.monotonic()

    def end(self, slot: int) -> None:
        """Note that none runs."""
        self._since[slot] = 0.0

    def running(self) -> dict[int, float]:
        """Return the slots whose command runs, and since when; all read at once, since commands end meanwhile."""
        return {slot: since for slot, since in enumerate(self._since.tolist()) if since}


def free(lock: Any) -> None:
    """Release an ``RLock`` as often as this thread holds it.

    An interrupt may come between the last line of a ``with`` block and the release of its lock.
    """
    with suppress(RuntimeError):  # this thread does not hold it, or does no more
        while True:
            lock.release()
