"""Declares an argument that its environment does not take."""

from gem_core import EnvSpec, hookimpl


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [
        EnvSpec(id="kwargs:One-v0", entry_point="gem_wrong_kwargs:one", summary="Nothing to do.", kwargs={"size": 3})
    ]


def one():
    """Make nothing."""
