"""Offers one id twice."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [
        EnvSpec(id="twice:One-v0", entry_point="gem_fine:FineEnv"),
        EnvSpec(id="twice:One-v0", entry_point="gem_fine:FineEnv"),
    ]
