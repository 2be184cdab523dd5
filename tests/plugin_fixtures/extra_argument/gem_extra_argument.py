"""A hook with an argument that does not exist."""

from gem_core import hookimpl


@hookimpl
def gem_register_envs(config):
    """Offer nothing."""
    return []
