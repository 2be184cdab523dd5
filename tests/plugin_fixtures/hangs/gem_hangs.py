"""Offers an environment whose module hangs, and one of another module after it."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [
        EnvSpec(id="hangs:One-v0", entry_point="gem_hangs_env:OneEnv"),
        EnvSpec(id="hangs:Typo-v0", entry_point="gem_hangs:Typo"),
    ]
