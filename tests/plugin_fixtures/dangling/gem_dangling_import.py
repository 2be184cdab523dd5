"""Needs what is not installed."""

import gem_core as gem
import gem_not_installed_anywhere


class MathEnv(gem.Env):
    """An environment."""

    helper = gem_not_installed_anywhere
