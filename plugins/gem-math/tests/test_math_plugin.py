"""What this distribution offers, and that its parts declare what they are."""

from __future__ import annotations

from importlib.metadata import entry_points


def test_the_plugin_is_found():
    """Its entry point names the module that declares what it offers."""
    points = {point.name: point.value for point in entry_points(group="gem.plugins")}
    assert points["math"] == "gem_math._plugin"
