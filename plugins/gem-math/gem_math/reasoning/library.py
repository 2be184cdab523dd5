"""``ask``: has reasoning-gym do something, in a process that outlives hostile answers and slow generators."""

from __future__ import annotations

import os
from typing import Any

from gem_core.errors import GemError, refuse_windows
from gem_math.processes import EndedError, Pool

refuse_windows("rg:*")

__all__ = ["EndedError", "LibraryError", "ask", "pool"]


class LibraryError(GemError):
    """reasoning-gym, or the process that runs it, failed whatever the agent did."""


pool = Pool("gem_math.reasoning.catalogue", "reasoning-gym", LibraryError, max(1, min(4, os.cpu_count() or 1)))


def ask(request: dict[str, Any], limit_s: float) -> dict[str, Any]:
    """Have the library do something; safe to call from several threads.

    Args:
        request: As ``catalogue.handle`` takes it.
        limit_s: Seconds of the processor's time after which the work is ended.

    Returns:
        The answer. ``"raised"`` in it is what the library raised, and ``"wrong"`` what is wrong with the request.

    Raises:
        EndedError: It took more than the limit, or died.
        LibraryError: The library cannot be loaded, or its process is ended from outside, or gets no time.
    """
    return pool.ask(request, limit_s)
