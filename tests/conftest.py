"""Registers the toy environments for every test of the core, and offers an empty registry and terminals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import toys
from in_terminal import InTerminal

from gem_core import plugins, registry

toys.register_toys()


@pytest.fixture
def own_registry(monkeypatch: pytest.MonkeyPatch) -> registry.Registry:
    """A registry that holds only what the core offers and what a test registers."""
    fresh = registry.Registry()
    monkeypatch.setattr(plugins, "_find", list)
    monkeypatch.setattr(registry, "_registry", fresh)
    return fresh


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[..., InTerminal]]:
    """Start the command in a terminal of its own; it is ended with the test."""
    started: list[InTerminal] = []

    def start(*arguments: str, **env: str) -> InTerminal:
        started.append(InTerminal(list(arguments), tmp_path, **env))
        return started[-1]

    yield start
    for each in started:
        each.close()
