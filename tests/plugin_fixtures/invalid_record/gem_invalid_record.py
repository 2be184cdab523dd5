"""A record with a bad id."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [
        EnvSpec(id="midway:Fine-v0", entry_point="gem_fine_env:FineEnv"),
        EnvSpec(id="no colon", entry_point="gem_fine_env:FineEnv"),
    ]
