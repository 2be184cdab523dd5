"""Small environments of several agents, for tests."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, ClassVar

from gem_core import AgentSelector, MultiAgentEnv, extract_last_boxed_answer


class CountdownEnv(MultiAgentEnv):
    r"""Two agents take 1 to 3 from a heap in turn; who takes the last wins. An answer that cannot be read takes 1."""

    possible_agents: ClassVar[tuple[str, ...]] = ("first", "second")

    def begin_episode(self, options: dict[str, Any] | None) -> None:
        """Draw the heap."""
        self.heap = int(self.np_random.integers(5, 12))
        self.unread = ""

    def observe(self, agent: str) -> str:
        """Show the heap, and to the one alone whose answer could not be read that it could not."""
        told = "Your last answer could not be read. " if agent == self.unread else ""
        return f"{told}The heap has {self.heap}. Take 1, 2 or 3, as \\boxed{{2}}."

    def process_actions(self, actions: dict[str, str]) -> Any:
        """Take from the heap."""
        ((agent, action),) = actions.items()
        answer = extract_last_boxed_answer(action)
        read = answer in ("1", "2", "3")
        self.unread = "" if read else agent
        self.heap = max(self.heap - (int(answer) if read else 1), 0)
        if self.heap:
            return {}, {}, {}, {agent: {"parsed_action": answer if read else None}}
        won = {each: 1.0 if each == agent else -1.0 for each in self.agents}
        over = dict.fromkeys(self.agents, True)
        return won, over, {}, {each: {"correct": reward > 0} for each, reward in won.items()}

    def sample_random_action(self, agent: str) -> str:
        """Take any number."""
        return f"\\boxed{{{self.action_random.integers(1, 4)}}}"


class AuctionEnv(MultiAgentEnv):
    """Who bids gets the number, and the agent before it in the alphabet pays it; ``quit`` leaves.

    Args:
        agents: Names.
        mode: Of the selector.
        rounds: Steps after which all that is left is terminated; None for none.
    """

    def __init__(self, agents: Sequence[str], mode: Any = "sequential", rounds: int | None = None) -> None:
        super().__init__()
        self.possible_agents = list(agents)
        self.agent_selector = AgentSelector(self.possible_agents, mode=mode)
        self.rounds = rounds
        self.bids: list[str] = []

    def begin_episode(self, options: dict[str, Any] | None) -> None:
        """Forget the bids."""
        self.bids = []

    def observe(self, agent: str) -> str:
        """Show the bids so far."""
        return f"You are {agent}. Bids: {' '.join(self.bids) or 'none'}"

    def process_actions(self, actions: dict[str, str]) -> Any:
        """Move the bids."""
        rewards = dict.fromkeys(self.agents, 0.0)
        for agent, action in actions.items():
            bid = int(action) if action.isdecimal() and len(action) < 4 else 0
            self.bids.append(str(bid))
            rewards[agent] += bid
            rewards[self._payer(agent)] -= bid
        over = self.rounds is not None and len(self.bids) >= self.rounds
        return rewards, {agent: over or actions.get(agent) == "quit" for agent in self.agents}, {}, {}

    def _payer(self, agent: str) -> str:
        ranked = sorted(self.agents)
        return ranked[ranked.index(agent) - 1]

    def sample_random_action(self, agent: str) -> str:
        """Bid anything, or quit once in five times."""
        draw = int(self.action_random.integers(0, 10))
        return "quit" if draw > 7 else str(draw)


class BrokenAuctionEnv(AuctionEnv):
    """An auction in which ``boom`` raises an exception and ``die`` ends the process."""

    def __init__(self) -> None:
        super().__init__(["a", "b"])

    def process_actions(self, actions: dict[str, str]) -> Any:
        """Fail as asked."""
        if "die" in actions.values():
            os._exit(3)
        if "boom" in actions.values():
            raise ValueError("boom")
        return super().process_actions(actions)
