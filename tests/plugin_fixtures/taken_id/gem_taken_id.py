"""Offers an id of the fine plugin, and one of its own."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [
        EnvSpec(id="taken:Own-v0", entry_point="gem_fine_env:FineEnv"),
        EnvSpec(id="fine:One-v0", entry_point="gem_fine_env:FineEnv"),
    ]
