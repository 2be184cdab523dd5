"""Bears the name of the fine plugin."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [EnvSpec(id="same:One-v0", entry_point="gem_fine_env:FineEnv")]
