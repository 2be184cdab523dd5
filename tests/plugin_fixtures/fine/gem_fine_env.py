"""The heavy part of the fine plugin, imported only by ``make``."""

from gem_core import TERMINAL_STATE, Env, Wrapper


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
