"""Offers an environment whose module hangs, and another behind it."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [
        EnvSpec(id="hangs:One-v0", entry_point="gem_hangs_env:OneEnv"),
        EnvSpec(id="hangs:Two-v0", entry_point="gem_hangs:gem_register_envs"),
    ]
