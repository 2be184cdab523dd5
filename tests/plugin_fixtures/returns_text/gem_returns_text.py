"""A hook that returns one id."""

from gem_core import hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return "text:One-v0"
