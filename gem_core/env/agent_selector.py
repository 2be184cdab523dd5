"""``AgentSelector``: says which agents of a ``MultiAgentEnv`` act next."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, get_args

from gem_core.errors import ArgumentError

SelectionMode = Literal["sequential", "parallel"]


class AgentSelector:
    """Says which agents act next: one after another, all at once, or as a subclass decides.

    An environment says by ``override`` who acts next, and may set ``order``; a subclass that decides by rules of its
    own overrides ``choose``.

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

    def next(self) -> list[str]:
        """Select who acts next, and return them; nobody if there are no agents."""
        chosen, self._overridden = self._overridden, []
        self.selected = chosen or list(self.choose())
        return self.selected

    def choose(self) -> list[str]:
        """Return who acts next, by the mode; a subclass may decide otherwise."""
        if self.mode == "sequential":
            self.order = [*self.order[1:], *self.order[:1]]
            return self.order[-1:]
        return self.order.copy()

    def override(self, *agents: str) -> None:
        """Let these agents act next, whatever the order, which stays as it is and continues after them."""
        self._overridden = list(agents)

    def add(self, agent: str) -> None:
        """Take in an agent, at the end of the order."""
        if agent not in self.order:
            self.order.append(agent)

    def remove(self, agent: str) -> None:
        """Take out an agent."""
        for names in (self.order, self.selected, self._overridden):
            if agent in names:
                names.remove(agent)
