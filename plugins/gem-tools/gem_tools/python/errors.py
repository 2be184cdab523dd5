"""The one error that a pool of sandboxes adds to those of the core."""

from __future__ import annotations

from gem_core.errors import GemError


class SandboxError(GemError):
    """A sandbox could not be started, or was lost with a call in it: no fault of the code, whose result is unknown."""
