"""What can be imported."""

import gem_core as gem

LIMIT = 3


class MathEnv(gem.Env):
    """An environment."""

    def __init__(self, length: int = 3) -> None:
        super().__init__()


class Helper:
    """Nothing that is offered."""


def make_tool():
    """Return what is no command, nor a tool."""
