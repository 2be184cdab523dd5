"""A hook with a misspelt name."""

from gem_core import hookimpl


@hookimpl
def gem_register_env():
    """Offer nothing, for nobody asks."""
    return []
