"""What can go wrong with sandboxes, besides the errors of the core."""

from __future__ import annotations

from gem_core.errors import GemError


class SandboxError(GemError):
    """A sandbox could not be started, or was lost with a call in it: no fault of the code, whose result is unknown."""


class Unavailable(Exception):
    """A level cannot be used here; the message says why and what to do."""
