"""A hook that returns records of another kind."""

from gem_core import ToolSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [ToolSpec(name="hammer", entry_point="gem_fine_env:Hammer")]
