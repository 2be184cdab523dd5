"""``AgentSelector``: says which agents of a ``MultiAgentEnv`` act next."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Literal, get_args

from gem_core.errors import ArgumentError

SelectionMode = Literal["sequential", "parallel"]


class AgentSelector:
    """Says which agents act next: one after another, all at once, or as a subclass decides.

    An environment changes the turns with ``override``, ``skip`` and ``reorder``; a subclass that decides by other rules
    overrides ``choose``.

    Args:
        agents: Names in the order of their turns.
        mode: ``"sequential"``: one agent acts, then the next in the order. ``"parallel"``: all act at once.

    Raises:
        ArgumentError: There is no such mode.

    Source: the agent cycle and the parallel interface of PettingZoo, arXiv:2009.14471.
    """

    def __init__(self, agents: Iterable[str] = (), mode: SelectionMode = "sequential") -> None:
        if mode not in get_args(SelectionMode):
            raise ArgumentError(f"mode must be 'sequential' or 'parallel', not {mode!r}")
        self.mode = mode
        self.reset(agents)

    def reset(self, agents: Iterable[str]) -> None:
        """Begin anew with these agents, in this order; nobody is selected until ``next`` is called."""
        self.order: list[str] = list(agents)
        """Who acts after the selected agents, the next one first."""
        self.selected: list[str] = []
        """Who acts now."""
        self._overridden: list[str] = []
        self._skips: dict[str, int] = {}

    def next(self) -> list[str]:
        """Select who acts next, and return them; nobody if there are no agents."""
        chosen, self._overridden = self._overridden, []
        self.selected = chosen or list(self.choose())
        return self.selected

    def choose(self) -> list[str]:
        """Return who acts next, by the mode; a subclass may decide otherwise.

        Agents that are to be skipped are passed over, and in ``"sequential"`` the chosen one goes to the end of
        ``order``.
        """
        if self.mode == "parallel":
            chosen: list[str] = []
            while self.order and not chosen:  # a round in which everybody is skipped passes
                chosen = [agent for agent in self.order if not self._is_skipped(agent)]
            return chosen
        while self.order:
            agent = self.order.pop(0)
            self.order.append(agent)
            if not self._is_skipped(agent):
                return [agent]
        return []

    def peek(self) -> list[str]:
        """Return what ``next`` would return, and change nothing."""
        return copy.deepcopy(self).next()

    def override(self, *agents: str) -> None:
        """Let these agents act next, whatever the order, which stays as it is and continues after them."""
        self._overridden = list(agents)

    def skip(self, agent: str, turns: int = 1) -> None:
        """Pass over the next turns of an agent."""
        self._skips[agent] = self._skips.get(agent, 0) + turns

    def reorder(self, agents: Iterable[str]) -> None:
        """Set the order from the next turn on.

        Raises:
            ArgumentError: They are not the agents that are in play, each once.
        """
        agents = list(agents)
        if sorted(agents) != sorted(self.order):
            raise ArgumentError(f"reorder takes each of {', '.join(map(repr, self.order))} once, not {agents!r:.200}")
        self.order = agents

    def add(self, agent: str) -> None:
        """Take in an agent, at the end of the order."""
        if agent not in self.order:
            self.order.append(agent)

    def remove(self, agent: str) -> None:
        """Take out an agent."""
        for names in (self.order, self.selected, self._overridden):
            if agent in names:
                names.remove(agent)
        self._skips.pop(agent, None)

    def _is_skipped(self, agent: str) -> bool:
        left = self._skips.get(agent, 0)
        if left:
            self._skips[agent] = left - 1
        return left > 0
