"""A hook that returns dictionaries."""

from gem_core import hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [{"id": "wrong:Type-v0"}]
