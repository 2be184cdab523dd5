"""Offers one id twice."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [
        EnvSpec(id="twice:One-v0", entry_point="gem_fine_env:FineEnv"),
        EnvSpec(id="twice:One-v0", entry_point="gem_fine_env:FineEnv"),
        EnvSpec(id="twice:Two-v0", entry_point="gem_fine_env:FineEnv"),
    ]
