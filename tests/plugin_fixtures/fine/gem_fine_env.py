"""The heavy part of the fine plugin, imported only by ``make``."""

import click

from gem_core import TERMINAL_STATE, Env, VectorEnv, Wrapper


class FineEnv(Env):
    """Any answer is right."""

    def reset(self, seed=None):
        """Ask."""
        super().reset(seed=seed)
        return "Say anything.", {}

    def step(self, action):
        """Reward."""
        return TERMINAL_STATE, 1.0, True, False, {}


class Shout(Wrapper):
    """Upper case."""

    def after_reset(self, result):
        """Shout the question."""
        return result[0].upper(), result[1]


class FineVectorEnv(VectorEnv):
    """A backend."""


class FineAgent:
    """An agent."""

    def __call__(self, observation):
        """Say anything."""
        return "anything"


@click.command("fine")
def command():
    """Say that it is fine."""
    click.echo("fine")
