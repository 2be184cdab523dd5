"""The real backends for tests: which are there, and why not the others."""

from __future__ import annotations

import functools
import os

import pytest
from docker_machines import BASE
from docker_machines import why_not as why_no_engine

from gem_terminal.backends.local import launch
from gem_terminal.errors import EngineError

os.environ.setdefault("GEM_TERMINAL_BASE_IMAGE", BASE)


@functools.cache
def why_not(name: str) -> str:
    """Return why a backend cannot be tested here; empty where it can."""
    if name == "docker":
        return why_no_engine()
    try:
        launch.probe()
    except EngineError as error:
        return str(error)
    return ""


def backend_names() -> list[object]:
    """Return both names as parameters, each skipped with the reason where it is not there."""
    return [
        pytest.param(name, marks=pytest.mark.skipif(bool(why_not(name)), reason=why_not(name) or "there"))
        for name in ("docker", "local")
    ]


needs_a_backend = pytest.mark.skipif(
    bool(why_not("docker") and why_not("local")), reason=f"{why_not('docker')}; {why_not('local')}"
)


def environment(backend: str, run: str) -> dict[str, str]:
    """Return the variables of a process that uses a backend, whose things bear a label of their own."""
    named = {"GEM_TERMINAL_BACKEND": backend, "GEM_TERMINAL_RUN": run, "GEM_TERMINAL_BASE_IMAGE": BASE}
    return {**os.environ, **named}
