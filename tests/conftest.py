"""Registers the toy environments for every test of the core, and offers an empty registry to those that want one."""

from __future__ import annotations

import pytest
import toys

from gem_core import plugins, registry

toys.register_toys()


@pytest.fixture
def own_registry(monkeypatch: pytest.MonkeyPatch) -> registry.Registry:
    """A registry that holds only what the core offers and what a test registers."""
    fresh = registry.Registry()
    monkeypatch.setattr(plugins, "_find", list)
    monkeypatch.setattr(registry, "_registry", fresh)
    return fresh
