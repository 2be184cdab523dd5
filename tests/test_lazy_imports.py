"""What an import loads, and what the public API promises of its names."""

from __future__ import annotations

import importlib.metadata
import inspect
import json
import subprocess
import sys

import pytest

import gem_core

HEAVY = [
    "aiohttp", "bm25s", "datasets", "docker", "gymnasium", "math_verify", "matplotlib", "mcp", "numpy", "openai",
    "pettingzoo", "pygame", "ray", "reasoning_gym", "textarena", "torch",
]  # fmt: skip
"""Packages that listing must not load."""

LIST_EVERYTHING = """
from gem_core import AgentSpec, CommandSpec, ToolSpec, VectorBackendSpec, WrapperSpec, list_envs
from gem_core.registry.lookup import registry
list_envs()
for kind in (AgentSpec, CommandSpec, ToolSpec, VectorBackendSpec, WrapperSpec):
    registry().specs(kind)
registry().plugins()
"""


def packages_loaded_by(code: str) -> set[str]:
    """Return the names of the top-level packages that a fresh interpreter has loaded after running the code."""
    tail = "\nimport json, sys\nprint(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code + tail], capture_output=True, text=True, check=True, timeout=60)
    return set(json.loads(done.stdout))


def plugin_packages() -> set[str]:
    """Return the packages of the installed plugins."""
    return {point.value.partition(".")[0] for point in importlib.metadata.entry_points(group="gem.plugins")}


def test_import_loads_nothing_heavy_and_no_plugin():
    """`import gem_core` loads no package but itself."""
    unwanted = {*HEAVY, *plugin_packages(), "click", "pluggy", "pydantic", "rich"}
    assert not packages_loaded_by("import gem_core") & unwanted


def test_listing_everything_loads_nothing_heavy():
    """Finding all environments, tools, wrappers, backends, agents and commands loads the plugins alone."""
    loaded = packages_loaded_by(LIST_EVERYTHING)
    assert not loaded & {*HEAVY, "pydantic", "rich"}
    assert plugin_packages() <= loaded


@pytest.mark.parametrize("name", gem_core.__all__)
def test_public_name_resolves_and_is_documented(name: str):
    """Each name in `__all__` exists, has a docstring where its kind can have one, and stands in `dir`."""
    value = getattr(gem_core, name)
    assert name in dir(gem_core)
    if inspect.isclass(value) or inspect.isfunction(value):
        assert (value.__doc__ or "").strip(), f"gem_core.{name} has no docstring"
        assert not value.__doc__.startswith(f"{name}("), f"gem_core.{name} has only a generated docstring"


def test_unknown_name_is_an_attribute_error():
    """A name that does not exist fails as in any module."""
    with pytest.raises(AttributeError, match="nonsense"):
        _ = gem_core.nonsense


def test_version_is_that_of_the_distribution():
    """`gem_core.__version__` repeats pyproject.toml, which costs no look-up at import."""
    assert gem_core.__version__ == importlib.metadata.version("gem-core")
