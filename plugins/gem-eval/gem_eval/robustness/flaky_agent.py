"""``FlakyAgent``: an agent whose model server fails now and then."""

from __future__ import annotations

from typing import Any

from gem_core.errors import RequestError
from gem_core.rollouts import Agent, Context
from gem_core.types import Observation
from gem_eval.robustness.perturbation import drawn

SERVER_FAULTS = {
    "server_429": "the server answered HTTP 429 Too Many Requests",
    "server_timeout": "the server did not answer in time",
}
"""What can happen to requests to a model server, each with the words of its error."""


class FlakyAgent:
    """Asks another agent, unless the request fails; one that fails is made again, as clients of model servers do.

    What fails is fixed by the seed, the episode and the turn. The other agent is asked at most once for each answer.

    Args:
        agent: The other agent.
        fault: One of ``SERVER_FAULTS``.
        rate: Probability that an attempt fails.
        retries: Attempts after the first; when all have failed, the episode ends in an error.
        seed: Of the run.
    """

    def __init__(self, agent: Agent, fault: str, *, rate: float = 0.2, retries: int = 2, seed: int = 0) -> None:
        self._agent, self._fault, self._rate, self._retries, self._seed = agent, fault, rate, retries, seed

    def __call__(self, observation: Observation, context: Context) -> Any:
        """Ask the other agent, or raise ``RequestError`` where every attempt fails."""
        where = (self._seed, self._fault, context.env_id, context.episode, context.turn)
        if all(drawn(self._rate, *where, attempt) for attempt in range(self._retries + 1)):
            raise RequestError(f"{SERVER_FAULTS[self._fault]} (injected), {self._retries + 1} times")
        return self._agent(observation, context)

    def __getattr__(self, name: str) -> Any:
        # What an agent may say of itself: how it reads, how many requests it takes at once, how it is prepared.
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._agent, name)
