"""What this distribution offers; it imports no tool."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core.hookspecs import hookimpl
from gem_core.specs import ToolSpec


@hookimpl
def gem_register_tools() -> Iterable[ToolSpec]:
    """The tools; each entry point takes the tool's options by keyword."""
    yield from ()
