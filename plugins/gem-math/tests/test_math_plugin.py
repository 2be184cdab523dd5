"""What this distribution offers, and that its parts declare what they are."""

from __future__ import annotations

import importlib.metadata
import sys
from importlib.metadata import entry_points

import pytest

import gem_core as gem
from gem_core.errors import MissingRequirementError


def test_the_plugin_is_found():
    """Its entry point names the module that declares what it offers."""
    points = {point.name: point.value for point in entry_points(group="gem.plugins")}
    assert points["math"] == "gem_math._plugin"


def test_without_the_extra_make_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ids stay listed."""
    version = importlib.metadata.version

    def without(name: str) -> str:
        if name == "reasoning-gym":
            raise importlib.metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(importlib.metadata, "version", without)
    monkeypatch.setitem(sys.modules, "reasoning_gym", None)
    with pytest.raises(MissingRequirementError, match=r'pip install "gem-math\[reasoning-gym\]"'):
        gem.make("rg:leg_counting")
