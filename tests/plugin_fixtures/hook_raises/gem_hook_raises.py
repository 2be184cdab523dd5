"""A hook raises after another has offered a record."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [EnvSpec(id="raises:One-v0", entry_point="gem_fine_env:FineEnv")]


@hookimpl
def gem_register_tools():
    """Fail."""
    raise ValueError("the first line\nand the second")
