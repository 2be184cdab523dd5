"""A task: what the simulated user wants, the reference actions, and what the reward looks at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Action:
    """One call of a tool."""

    name: str
    arguments: dict[str, Any]
    compare: tuple[str, ...] | None = None
    """Arguments by which a call is compared with this one where the reward looks at calls; None for all."""

    def matches(self, call: Action) -> bool:
        """Return whether a call of the assistant is this one, as tau2-bench compares them."""
        if self.name != call.name:
            return False
        names = call.arguments.keys() if self.compare is None else self.compare
        return {name: value for name, value in self.arguments.items() if name in names} == {
            name: value for name, value in call.arguments.items() if name in names
        }


@dataclass(frozen=True)
class Task:
    """One task of a benchmark."""

    id: str
    """``test-0`` for the first of tasks_test.json; the file's own id in tau2-bench."""

    instruction: str
    """What the simulated user is told: who they are, what they want and how they behave."""

    actions: tuple[Action, ...] = ()
    """Reference actions: the final database must be the one that they lead to."""

    outputs: tuple[str, ...] = ()
    """What the assistant must say to the user."""

    reward_basis: tuple[str, ...] = ("DB", "COMMUNICATE")
    """Components whose product is the reward, of ``DB``, ``COMMUNICATE``, ``ACTION``."""

    user_id: str | None = None
    """The user's id in the database, where the file has it."""
