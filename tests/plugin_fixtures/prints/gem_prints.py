"""Writes to standard output while it is imported."""

from gem_core import EnvSpec, hookimpl

print("hello from a plugin")  # noqa: T201 - the mistake under test


@hookimpl
def gem_register_envs():
    """Offer environments."""
    return [EnvSpec(id="prints:One-v0", entry_point="gem_prints:one", summary="Nothing to do.")]


def one():
    """Make nothing."""
