"""A hook that forgot its return."""

from gem_core import hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    pass
