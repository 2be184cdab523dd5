"""Every hook is documented by an example that works."""

from __future__ import annotations

import inspect
import textwrap
from typing import Any

import pytest

from gem_core.registry import hookspecs
from gem_core.registry.plugins import RECORD_TYPES


def test_every_hook_is_known_to_the_loader() -> None:
    """What is declared is asked for, and nothing else."""
    declared = {name for name in vars(hookspecs) if name.startswith("gem_")}
    assert declared == set(RECORD_TYPES)


@pytest.mark.parametrize("name", RECORD_TYPES)
def test_the_example_of_a_hook_returns_its_records(name: str) -> None:
    """As it stands in the docstring."""
    _, _, example = (inspect.getdoc(getattr(hookspecs, name)) or "").partition("Example::")
    assert example, "a hook is documented with an example"
    scope: dict[str, Any] = {"hookimpl": hookspecs.hookimpl}
    scope |= {record_type.__name__: record_type for record_type in RECORD_TYPES.values()}
    exec(textwrap.dedent(example), scope)
    records = list(scope[name]())
    assert records
    assert all(type(record) is RECORD_TYPES[name] for record in records)
