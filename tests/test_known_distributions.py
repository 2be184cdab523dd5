"""Which distribution of this project offers what, for advice where one is not installed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from gem_core.registry.known_distributions import KNOWN_DISTRIBUTIONS
from gem_core.registry.lookup import registry
from gem_core.registry.specs import CallFormatSpec, EnvSpec, RequirementSpec

if TYPE_CHECKING:
    from command_calls import RunGem

OURS = {path.parent.name for path in Path(__file__).parent.parent.glob("plugins/*/pyproject.toml")}
INSTALLED = [plugin for plugin in registry().plugins() if plugin.distribution in OURS]


@pytest.mark.parametrize("plugin", INSTALLED, ids=lambda plugin: plugin.distribution)
def test_all_that_a_plugin_offers_is_known(plugin: Any) -> None:
    """And is looked for in no distribution that does not have it."""
    offered = {
        ("namespace", record.namespace) if isinstance(record, EnvSpec) else (record.kind, record.name)
        for record in plugin.records
        if not isinstance(record, RequirementSpec | CallFormatSpec)  # nobody asks for them by name
    }
    known = KNOWN_DISTRIBUTIONS[plugin.distribution]
    assert offered == {(kind, name) for kind, names in known.items() for name in names.split()}


def test_a_command_of_a_plugin_that_is_not_installed_says_what_to_install(run_gem: RunGem, own_registry: Any) -> None:
    """As ids and other names do."""
    done = run_gem("serve-search")
    assert done.code == 2
    assert done.err.startswith(
        "gem: no command 'serve-search'. It comes with a plugin: try 'pip install gem-tools'. There are: list, "
    )
