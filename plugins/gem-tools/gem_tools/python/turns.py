"""Whose turn it is when there are more calls than sandboxes: who came first, among those that one can serve."""

from __future__ import annotations

import collections
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import asyncio

    from gem_tools.python.cell import Cell


@dataclass(eq=False)
class Ticket:
    """A call that waits for its turn.

    Args:
        number: Earlier ones are served first.
        turn: Gets the sandbox.
        cell: The only sandbox that will do; None for any.
    """

    number: int
    turn: asyncio.Future[Cell]
    cell: Cell | None = None


@dataclass(eq=False)
class Turns:
    """Who waits, in the order of their coming: for any sandbox, or for the one that holds their session."""

    free: collections.deque[Ticket] = field(default_factory=collections.deque)
    bound: dict[Cell, collections.deque[Ticket]] = field(default_factory=dict)

    def add(self, ticket: Ticket) -> None:
        """Let one more wait."""
        queue = self.free if ticket.cell is None else self.bound.setdefault(ticket.cell, collections.deque())
        queue.append(ticket)

    def next_for(self, cell: Cell) -> Ticket | None:
        """Take out who has waited longest among those that this sandbox can serve."""
        queues = [queue for queue in (self.free, self.bound.get(cell)) if queue is not None]
        for queue in queues:
            while queue and queue[0].turn.done():
                queue.popleft()
        waiting = [queue for queue in queues if queue]
        return min(waiting, key=lambda queue: queue[0].number).popleft() if waiting else None

    def everyone(self) -> list[Ticket]:
        """Return all who wait."""
        queues = [self.free, *self.bound.values()]
        return [ticket for queue in queues for ticket in queue if not ticket.turn.done()]
