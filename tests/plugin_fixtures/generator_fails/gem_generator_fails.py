"""A generator that fails midway."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    yield EnvSpec(id="midway:One-v0", entry_point="gem_fine_env:FineEnv")
    raise RuntimeError("no second one")
