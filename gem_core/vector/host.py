"""``Host``: where environments live and run; a vector environment has one or several."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any, Protocol

from gem_core.vector.body import Body
from gem_core.vector.commands import Command, Failure, Outcome

Launch = tuple[int, int, Command]
"""Slot, ticket, command. The ticket tells an answer that is waited for from one that comes too late."""


class Listener(Protocol):
    """What a host tells, from any thread: the other side of a ``Host``."""

    def advance(self, host: Host, slot: int, ticket: int, outcome: Outcome) -> Launch | None:
        """Take what came of a command.

        Returns:
            What to do next for this slot in the same place; None where there is nothing.
        """
        ...

    def is_current(self, slot: int, ticket: int) -> bool:
        """Tell whether an answer under this ticket is still waited for."""
        ...

    def lose(self, host: Host, guilty: dict[int, Failure], others: list[int]) -> None:
        """Note that environments are gone: those that did it, each with what happened, and those beside them."""
        ...

    def first_under_way(self, slots: list[int]) -> list[int]:
        """Return the first of some slots whose command is under way, as a list of one, or none."""
        ...

    def look_after(self, host: Host) -> float | None:
        """Give up what takes too long; return in how many seconds to look again, None for never."""
        ...


def free(lock: Any) -> None:
    """Release an ``RLock`` as often as this thread holds it.

    For what an interrupt left: it may come between the last line of a ``with`` block and the release of its lock.
    """
    with suppress(RuntimeError):  # this thread does not hold it, or does no more
        while True:
            lock.release()


class Host(ABC):
    """Where environments live and run.

    A slot's commands come one at a time. What a host cannot contain, it does not promise; see the table in the
    documentation of the backends.
    """

    replays = False
    """Whether environments may be lost with the process that they live in, so that their episodes are recorded."""

    engine: Listener

    def in_place(self, slot: int, command: Command) -> Body | None:
        """Return the slot's body where the command takes but microseconds and can be done by the caller at once."""
        return None

    @abstractmethod
    def start(self, batch: list[Launch]) -> None:
        """Begin to do commands; each is answered by ``engine.advance``, in any order, from any thread."""

    @abstractmethod
    def ask(self, slot: int, question: str, *args: Any) -> Any:
        """Answer a question about a slot's environment.

        ``"sample"``, with the seed of the episode's random actions, and a function that says how to rebuild the
        environment if it was lost: a valid action. ``"describe"``: its id, keyword arguments and wrappers.
        ``"num_tasks"``, with an id and keyword arguments: the number of tasks of its data set, or None; this makes the
        environment if it is not there. ``"endless_tasks"``, with the same: whether it has fresh ones for every epoch.
        """

    @abstractmethod
    def release(self, slot: int) -> None:
        """Close a slot's environment, if there is one."""

    def overdue(self, now: float) -> list[int]:
        """Return the slots whose command takes longer than ``step_timeout``, by ``time.monotonic()``."""
        return []

    def next_check(self, now: float) -> float | None:
        """Return in how many seconds ``overdue`` is worth asking again; None for never."""
        return None

    def timed_out(self, slot: int) -> Failure:
        """Return what ``info["error"]`` says of a command that took too long."""
        return Failure("timeout", "it took longer than step_timeout")

    def abandon(self, slot: int, failure: Failure) -> Failure:
        """See to it that a slot's command does no more harm, and that the slot can be used again.

        Asked only of a host whose ``overdue`` returns slots.

        Returns:
            What happened, as it is to be reported; a host that kills a process calls ``engine.lose`` for the others.

        Raises:
            FaultBudgetError: Too much has been abandoned.
        """
        raise NotImplementedError(f"{type(self).__name__} says what is overdue, and does not define abandon")

    @abstractmethod
    def close(self) -> None:
        """Close every environment, and end what runs them; calling it again does nothing."""

    @abstractmethod
    def renewed(self) -> Host:
        """Leave this host, which an interrupt may have left in the middle of something; return one in its place."""
