"""Offers an environment whose module fails."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [EnvSpec(id="heavy:One-v0", entry_point="gem_heavy_missing:HeavyEnv")]
