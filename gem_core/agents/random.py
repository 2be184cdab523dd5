"""The agent that answers at random."""

from __future__ import annotations

from gem_core.rollouts.agent import Context
from gem_core.types import Observation


class RandomAgent:
    """Draws a valid action of the environment in every state."""

    reads = "observation"

    def __call__(self, observation: Observation, context: Context) -> str:
        """Return what the environment's ``sample_random_action`` draws."""
        return context.sample_random_action()
