"""What this distribution offers; it imports no server."""

from __future__ import annotations

from collections.abc import Iterable

from gem_core import WrapperSpec, hookimpl


@hookimpl
def gem_register_wrappers() -> Iterable[WrapperSpec]:
    """The wrapper ``harness``."""
    return [
        WrapperSpec(
            name="harness",
            entry_point="gem_server.harness:Harness",
            summary="A program that asks a model plays the task; each of its requests is a turn.",
        )
    ]
