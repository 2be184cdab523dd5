"""Declares what is there, and imports a package that is heavy."""

import numpy as np  # the mistake under test

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [EnvSpec(id="heavily:One-v0", entry_point="gem_heavy_import:one", summary="Nothing to do.")]


def one():
    """Make nothing."""
    return np.zeros(1)
